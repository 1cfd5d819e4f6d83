"""The single environment: one route, Gymnasium's ``Env``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from amusic_gym.envs.infos import Infos
from amusic_gym.envs.pictures.viewer import viewer_for
from amusic_gym.envs.registration import Specified
from amusic_gym.envs.rewards import Reward
from amusic_gym.envs.sources import BankLike, RouteSource
from amusic_gym.envs.task import RENDER_FPS, RENDER_MODES, Task, as_seed
from amusic_gym.estimation.settings import COVERAGE, SICSettings


class TechniqueSelectionEnv(Specified, gym.Env[NDArray[np.float32], NDArray[np.int8]]):
    """Choose, frame by frame, which place-recognition techniques are worth their compute.

    ## Description
    A robot drives along a mapped route. For every camera frame it may run any of T visual place
    recognition techniques; each costs time and gives one similarity score per place of the map.
    SIC corrects every technique that ran by the continuity of its matches, and MuSIC trusts the
    most consistent one (A-MuSIC, III-A and III-B): its match is the prediction. The agent decides
    what runs.

    With `statistic="evidence"`, the default, the candidates that SIC chooses from are the K best
    places of the row and two that are carried on from earlier frames, the technique's own last
    match and the last prediction; and MuSIC trusts a technique less whose neighbouring rows are
    alike. `carry=False` and `discount=False` turn these off; `statistic="mean"` is the paper's,
    which knows neither. With `statistic="belief"`, all that ran feed one belief over the places,
    which moves as a robot may that stops, hurries or is carried away
    (:mod:`amusic_gym.estimation.belief`); the place whose surroundings hold most of it is the
    prediction.

    ## Action Space
    `MultiBinary(T)`: bit t runs technique t on the *next* frame. With `slots=S` there are S bits
    and S groups of the observation, whatever the route's T; the bits of empty slots do nothing.
    Values are checked, not the dtype: 1, 1.0 and True are the same. For algorithms that take no
    bits, :mod:`amusic_gym.envs.wrappers` has actions of one or several numbers, with masks.

    With `reselection=M` there is one more bit, last: "re-select". It runs, before the frame is
    processed, every technique on those of the last M frames (as many as there are) that it missed,
    and replaces the other bits by the selection of A-MuSIC (III-C1). On the first frame there is
    nothing to select from, and the other bits hold.

    An all-zero action runs the cheapest technique, and `info["fallback"]` says so. With
    `allow_idle=True` nothing runs: the prediction moves on by one place, and p̂ and confidence
    decay; with `belief`, it moves on by itself.

    ## Observation Space
    A flat float32 `Box` in [−1, 1]: T equal groups, one per technique, then the route's group.
    *squash* is x / (|x| + 4). Running means weigh the newest value by 0.2 and start at 0. A star:
    not so with `belief`, see below the tables.

    | per technique | meaning |
    |---|---|
    | present | 1; all entries of an empty slot are 0 |
    | ran | 1 if it ran on this frame |
    | statistic | squash of its SIC statistic at its last run * |
    | margin | squash of that over its best rival beyond the tolerance * |
    | correction | squash of its last correction: its statistic less that of its uncorrected match |
    | agrees | 1 if its last match, moved along its diagonal, is the fused one (± tolerance) |
    | agreement | running mean of agrees over its runs |
    | support | squash of the z-score that its last row gives to the fused prediction |
    | support_mean | squash of the running mean of support |
    | stored | squash of the statistic that the fused diagonal had at its last run * |
    | weight | of its rows: 1, or less where they repeat the ones before; 0 before its first run * |
    | age | squash of the frames since its last run; 1 before the first |
    | chosen | 1 if MuSIC trusts it on this frame |
    | cost_share | seconds / Σ seconds |
    | cost_log | 1 + log10(cost_share) / 4, at least −1 |
    | price | λ · cost_share on a logarithmic scale, 0.001 → −1, 0.1 → 0, 10 → 1, clipped |
    | confirms | 1 if the best place of its last row was by itself the fused one (± tolerance) |
    | confirmation | running mean of confirms over its runs |
    | support_usual | squash of a slow mean of support: of n values the newest weighs 1/n, or 0.02 |
    | dissent | squash of its statistic less stored: how much it would rather be elsewhere |

    | route | meaning |
    |---|---|
    | compute_weight | λ on a logarithmic scale, 0.01 → −1, 10 → 1, clipped |
    | has_prediction | 1 once there is a prediction |
    | statistic | squash of the confidence, the fused winner's statistic * |
    | margin | squash of that over the best rival of any technique that ran * |
    | p_correct | p̂ |
    | p_correct_mean | running mean of p̂ |
    | continues | 1 if the prediction moved on by exactly one place |
    | since_doubt | squash of the frames since p̂ was below 0.5 |
    | elapsed | squash of the frames so far |
    | compute | squash of this step's seconds / Σ seconds |
    | compute_mean | squash of its running mean |
    | agreeing | share of the techniques whose diagonal is the fused one |
    | p_steady | probability of steady motion, one place per frame, by `belief` |
    | log_likelihood | squash of that of the prediction by this frame's rows, by `belief` |
    | log_likelihood_mean | squash of the running mean of what each row gave it |
    | size | places of the map on a logarithmic scale, 1 → −1, 1000 → 0, a million → 1, clipped |
    | logit | squash of log(p̂ / (1 − p̂)), which lies between −30 and 30 |
    | since_confirmed | squash of the frames since a technique that ran confirmed the prediction |
    | track | squash of a tenth of the frames in a row on which the prediction continued |
    | supported | how far another technique supports the prediction, see below; 0 with `belief` |
    | on_map | probability of being on the map, by how rows looked lately against what is usual |

    A technique's *weight* is what MuSIC multiplies its statistic by, √((1 − ρ) / (1 + ρ)) with ρ
    the correlation of its neighbouring rows; 1 without `discount`. The route's *margin* is between
    statistics so multiplied. A technique other than the trusted one *supports* the prediction if
    its last match, moved along its diagonal, is the fused one: by 0.98 to the power of that match's
    age, times 1 less the correlation of its row with the trusted technique's where both ran last.
    The highest counts.

    With `belief`, a technique's *statistic* is the log-odds of the place that its last row and the
    belief before it make the most probable, within the tolerance; its *margin* the logarithm of
    that probability over its best rival's; *stored* the log-likelihood that its last row gave the
    fused place then. The *confidence* is the calibrated log-odds of being within the tolerance,
    and the *margin* over the rival the log ratio of the belief around the fused place and around
    the best one that shares no place with it. A technique's *weight* is that of its last row: less
    where it says little that is new, and where others that ran on the frame err alike. With the
    other statistics, `p_steady`, `log_likelihood` and its mean are 0.

    ## Rewards
    p̂ − λ · (seconds run in this step / Σ seconds), from declared seconds; the terms are in
    `info["reward_terms"]`. p̂ is estimated correctness, calibrated on simulated routes: no ground
    truth is needed.

    ## Starting State
    Nothing has run, the prediction is −1, the history is empty.

    ## Episode End
    One step per frame. The route's end terminates; `episode_length` truncates.

    ## Information
    The same keys and shapes at every step, zeros where a technique did not run (`ran` is the
    mask): `frame`, `route` (number of the bank), `prediction`, `confidence`, `p_correct`,
    `similarity` (z-score of the prediction in this frame's row of the trusted technique, 0:
    nothing ran), `margin`, `technique` (that MuSIC trusts, −1: none), `ran`, `place`,
    `statistic`, `correction`, `present`, `run_seconds` (what one run of each technique costs,
    whether it ran or not), `seconds` (what this step cost), `fallback`, `idle`,
    `compute_weight`, `reward_terms` and, with `reselection`, `selection` (`happened`, `tally`,
    `selected`, `corrections` (T, M), `late_runs`). Never ground truth.

    ## Arguments
    See :class:`amusic_gym.envs.task.Task`, among them `statistic`, `carry` and `discount`. Without
    `bank`, routes are simulated, of four techniques and of the motion that the statistic is made
    for: steady drives through changing conditions; for `belief`, most with stops, other speeds and
    jumps. `reset` takes the options `bank`, `start` and `compute_weight`, each a number; they hold
    for the episode that it begins, and the next draws anew.

    ```python
    >>> import gymnasium as gym
    >>> env = gym.make("amusic_gym:amusic_gym/TechniqueSelection-v0", compute_weight=0.5)
    >>> observation, info = env.reset(seed=1)
    >>> observation, reward, terminated, truncated, info = env.step([1, 0, 0, 0])
    >>> info["ran"].tolist()
    [True, False, False, False]

    ```

    ## Version History
    * v0: may change until release 1.0.0. The observation is of version 6: on_map of the route
      came, and p̂ falls off the map; of version 5: p_steady, log_likelihood and its mean took the
      place of three entries of an earlier belief. The default statistic went from `belief` to
      `evidence`, with carried candidates and the discount.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
    }

    def __init__(
        self,
        bank: BankLike | Sequence[BankLike] | RouteSource | None = None,
        *,
        statistic: str = SICSettings.statistic,
        candidates: int = SICSettings.candidates,
        history: int = SICSettings.history,
        gamma: float = SICSettings.gamma,
        carry: bool | None = SICSettings.carry,
        discount: bool | None = SICSettings.discount,
        compute_weight: float | tuple[float, float] = 1.0,
        reselection: int | None = None,
        coverage: float = COVERAGE,
        allow_idle: bool = False,
        slots: int | None = None,
        episode_length: int | None = None,
        random_start: bool = False,
        costs: str = "measured",
        reward: str | Reward = "estimated",
        threads: int = 1,
        render_mode: str | None = None,
        **unknown: Any,
    ) -> None:
        self.task = Task(
            1,
            bank,
            statistic=statistic,
            candidates=candidates,
            history=history,
            gamma=gamma,
            carry=carry,
            discount=discount,
            compute_weight=compute_weight,
            reselection=reselection,
            coverage=coverage,
            allow_idle=allow_idle,
            slots=slots,
            episode_length=episode_length,
            random_start=random_start,
            costs=costs,
            reward=reward,
            threads=threads,
            render_mode=render_mode,
            unknown=unknown,
        )
        self.render_mode = render_mode
        self._viewer = viewer_for(self.task.episodes, render_mode, RENDER_FPS)
        self.observation_space = self.task.observation_space
        self.action_space = self.task.action_space
        self._action_shape = self.task.action_space.shape
        self._running = False

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Infos]:
        """Begin an episode; nothing runs yet.

        Args:
            seed: whole number that fixes this and all later episodes.
            options: for this episode only, any of ``bank``, ``start`` and ``compute_weight``: a
                number each.

        Raises:
            ValueError: for another seed or option.
        """
        super().reset(seed=as_seed(seed))
        self.task.begin(0, self.np_random, options)
        self._running = True
        out = self.task.episodes.look()
        if self._viewer is not None:
            self._viewer.look()
        return out.observation[0], self.task.begun_info(out)

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, Infos]:
        """Run the chosen techniques on the next frame.

        Raises:
            ResetNeeded: before the first reset and after an episode's end.
            ValueError: for an action outside the action space.
        """
        if not self._running:
            raise ResetNeeded("no episode is running; call reset() first, and after every end")
        checked = self.task.check_actions(action, self._action_shape)
        out, reward, terminated, truncated, info = self.task.step_one(checked)
        self._running = not (terminated or truncated)
        if self._viewer is not None:
            self._viewer.look()
        return out.observation[0], reward, terminated, truncated, info

    def render(self) -> str | NDArray[np.uint8] | list[NDArray[np.uint8]] | None:  # type: ignore[override]
        """The last frame: one line with ``render_mode="ansi"``, a picture with ``"rgb_array"``.

        With ``"rgb_array_list"``, the pictures since the last call or the reset. The window of
        ``"human"`` follows every reset and step by itself. No mode shows the ground truth.
        """
        shown = self.task.render(self.render_mode, self._viewer)
        return None if shown is None else shown[0]

    def close(self) -> None:
        """Close the window, if there is one; twice is fine."""
        if self._viewer is not None:
            self._viewer.close()
