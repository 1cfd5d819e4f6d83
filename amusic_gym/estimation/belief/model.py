"""What the belief takes for granted of robots and techniques.

Chosen on five tours, Corridor, Gardens Point, Nordland and simulated routes, as recorded and with
other motions, by the mean and the worst of them (docs/belief.md).
"""

from __future__ import annotations

# Motion.

SPEEDS = 6
"""Modes that jump: 0, ½, 1, 1½ and 2 places per frame, and one place backwards."""

BACKWARDS = SPEEDS - 1
"""The mode of one place backwards per frame."""

STEADY = SPEEDS
"""The mode of exactly one place per frame."""

MODES = SPEEDS + 1

REACH = 3
"""Most places that one frame moves forwards, slack included."""

REACH_BACK = 2
"""The same backwards."""

SHARES = (0.124375, 0.124375, 0.4975, 0.124375, 0.124375, 0.005)
"""How often each speed is drawn."""

LASTING = 0.1
"""Chances that driving backwards ends, or jumps, relative to those of the other speeds."""

START_STEADY = 0.55
"""Probability of steady motion before anything is seen."""

CHANGE = 0.02
"""Probability per frame of drawing a speed."""

SETTLE = 0.005
"""Probability per frame that steady motion begins."""

LEAVE = 1e-4
"""Probability per frame that it ends."""

SLACK = 0.005
"""Probability of a place less, and of one more, than a whole speed says."""

JUMP = 0.01
"""Probability per frame of a jump to a uniform place."""

STEADY_JUMP = 1.5e-4
"""The same in steady motion."""

# Rows.

HUB_STEP = 0.15
"""Weight of the newest row in a technique's mean row."""

VARIANCE_STEP = 0.02
"""Least weight of the newest row in the variance of a place's scores."""

LEAST_VARIANCE = 0.05
"""Variance below which a place is not taken for a steadier one."""

SLOPE = 1.2
"""Log-likelihood per standard deviation of a place's score, far above the floor."""

FLOOR = 0.5
"""Probability that a row is about anything but the place: its likelihood never falls below."""

# Standing, which is seen in rows with less news than usual.

USUAL_STEP = 0.03
"""Least weight of the newest row in the variance of a technique's news."""

LIVELY = 0.2
"""Variance of the news, in that of a row, above which a technique's rows tell standing: those of
others may hardly change on the move."""

ACQUAINTED = 20
"""Rows after which what is usual is known."""

STILL = 0.45
"""Deviation of the news, in the usual one, that speaks neither for standing nor against it."""

STAND = 3.0
"""Log-likelihood of standing per unit below that."""

NOT_STANDING = -0.5
"""The least of it."""

# Techniques.

LIKENESS = 0.3
"""Correlation of the errors of two techniques that never seem to err alike."""

LIKENESS_STEP = 0.1
"""Least weight of the newest frame in the running mean of a correlation."""

AWAY = 10
"""Places around the likeliest one left out of it, where techniques may agree; a tenth of the map
at most."""

SWEEPS = 30
"""Iterations that the weights of the techniques are found by."""

# Places.

SURE = 1e-12
"""The least probability that a logarithm is taken of."""

ENOUGH = 0.99
"""A window that holds this share of the most that any does is as good."""
