"""Sphinx's settings: `make docs` builds the site to out/docs."""

from __future__ import annotations

import inspect

from sphinx.application import Sphinx

import amusic_gym
from amusic_gym.envs.env import TechniqueSelectionEnv

project = "amusic-gym"
release = amusic_gym.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["requirements.txt", "pictures.py"]

html_theme = "furo"
html_title = "amusic-gym"
html_show_copyright = False

myst_heading_anchors = 3
nb_execution_timeout = 300
nb_execution_raise_on_error = True

autodoc_member_order = "bysource"
autodoc_typehints = "description"
default_role = "code"  # docstrings set names in single or double ticks

DOCSTRING = "{{ environment }}"
CARDS = {
    "../amusic_gym/techniques/pretrained/CARD.md": "cards/techniques.md",
    "../agents/amusic_agents/pretrained/CARD.md": "cards/selectors.md",
}
"""Files beside the weights, as the pages link to them → their pages of the site."""


def prepare(app: Sphinx, page: str, source: list[str]) -> None:
    """Put in the environment's docstring, which is its manual page, and link to the cards."""
    text = source[0].replace(DOCSTRING, inspect.getdoc(TechniqueSelectionEnv) or "")
    for file, card in CARDS.items():
        text = text.replace(file, card)
    source[0] = text


def setup(app: Sphinx) -> None:
    """Register what a page goes through."""
    app.connect("source-read", prepare)
