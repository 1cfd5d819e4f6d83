"""A belief over the map's places, fed by every score row that a technique computes.

SIC and MuSIC (A-MuSIC, III-A and III-B) follow diagonals of the score matrix: they hold while the
robot moves exactly one place per frame. This is a Bayes filter (Markov localisation) over place and
way of moving, shared by all techniques of a route. ``docs/belief.md`` says what each part is worth.

* **Rows** (:mod:`~amusic_gym.estimation.belief.rows`). Errors last: what a technique's rows of late
  said, and what each place usually gets, is taken out before a row counts.
* **Techniques** (:mod:`~amusic_gym.estimation.belief.agreement`). Techniques that err alike share
  one vote: a copy of a technique changes nothing.
* **Motion** (:mod:`~amusic_gym.estimation.belief.motion`). Steady motion, one place per frame, or
  one of six speeds with jumps.

Every constant stands in :mod:`~amusic_gym.estimation.belief.model`.
"""

from __future__ import annotations
