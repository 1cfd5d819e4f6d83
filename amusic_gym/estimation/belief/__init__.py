"""A belief over the map's places, fed by every score row that a technique computes.

SIC and MuSIC (A-MuSIC, III-A and III-B) follow diagonals of the score matrix: they hold while the
robot moves exactly one place per frame. This filter keeps the idea, that a match must continue
those before it, and lets go of the constant speed. It is a Bayes filter (Markov localisation) over
place and way of moving, the same for all techniques:

* **Motion.** Besides five speeds, there is a steady way of moving, one place per frame without
  jumps. The belief in it grows while nothing else is seen, so a recording as the paper knows them
  is summed along its diagonals.
* **Rows.** Of each row's z-scores the place's own mean and deviation over the frames so far are
  taken out, because hubs that attract every query help nobody. A row that repeats the technique's
  last one says little (noise is correlated in time); a frame whose rows are the same as those
  before it says that the robot stands.
* **Trust.** A row says nothing, or something, or that twice or four times as sharply: each with a
  probability that is learned as the robot drives, per technique, from what the past and the other
  techniques say. So no row can rule a place out.

A frame costs a few passes over R numbers for each technique that ran, and a few more for the
motion, whatever ran before. The rates were fitted on simulated routes only
(``scripts/fit_belief.py``).
"""

from __future__ import annotations

from amusic_gym.estimation.belief.rates import Rates, fitted, stored

__all__ = ["Rates", "fitted", "stored"]
