"""Settings behind a technique's name: ``effnet:10``, ``effnet-rmac:block=12:whole=yes``."""

from typing import Any

from amusic_gym.utils.names import suggest

_FLAGS = {"yes": True, "no": False}


def parsed(argument: str, **defaults: Any) -> dict[str, Any]:
    """The settings that ``argument`` gives, and the defaults of the others.

    Args:
        argument: ``NAME=VALUE``, with colons between; the first may stand without its name.
        defaults: name → value, whose type says what may be given: a whole number, a text, or
            ``yes`` or ``no``.

    Raises:
        ValueError: for an unknown name, one that is given twice, or a value of another type.
    """
    given: dict[str, Any] = {}
    for number, piece in enumerate(argument.split(":") if argument else ()):
        name, equals, text = piece.partition("=")
        if not equals and number == 0:
            name, text = next(iter(defaults)), piece
        if name not in defaults:
            raise ValueError(suggest("setting of the technique", name, defaults))
        if name in given:
            raise ValueError(f"the technique's setting {name} is given twice; give it once")
        given[name] = _value(name, text, defaults[name])
    return {**defaults, **given}


def _value(name: str, text: str, default: Any) -> Any:
    if isinstance(default, bool):
        if text not in _FLAGS:
            raise ValueError(f"the technique's setting {name} is {text!r}; give yes or no")
        return _FLAGS[text]
    if isinstance(default, int):
        if not text.isdecimal():
            raise ValueError(f"the technique's setting {name} is {text!r}; give a whole number")
        return int(text)
    return text
