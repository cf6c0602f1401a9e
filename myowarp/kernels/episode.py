"""Bookkeeping of episodes: faults, reward, termination, truncation, success, final values."""

import warp as wp
from mujoco_warp import OverflowType

from myowarp.kernels.action import FAULT_ACTION
from myowarp.kernels.observe import pack
from myowarp.kernels.random import RandomKeys
from myowarp.kernels.structs import zeros_of

FAULT_NONFINITE = wp.constant(1)
FAULT_ROWS = wp.constant(2)
FAULT_CONTACTS = wp.constant(4)
FAULT_OBSERVATION = wp.constant(16)
FAULT_REWARD = wp.constant(32)

FAULTS = {
    int(FAULT_NONFINITE): "state not finite",
    int(FAULT_ROWS): "more constraint rows than allocated",
    int(FAULT_CONTACTS): "more contacts than allocated",
    int(FAULT_ACTION): "action not finite",
    int(FAULT_OBSERVATION): "observation not finite",
    int(FAULT_REWARD): "reward not finite",
}
"""Meaning of the bits of a fault."""


def describe_fault(bits: int) -> str:
    """Return the meaning of the bits of a fault."""
    return ", ".join(text for bit, text in FAULTS.items() if bits & bit)


STATE_LIMIT = wp.constant(1.0e10)  # largest state entry that MuJoCo accepts, mjMAXVAL
LARGEST = wp.constant(3.4028234663852886e38)  # finite float32
SUCCESS_STEPS = wp.constant(5)  # an episode that succeeds has more solved steps than this; MyoSuite

ROW_BITS = wp.constant(int(OverflowType.NEFC | OverflowType.NJMAX_NNZ))
CONTACT_BITS = wp.constant(int(OverflowType.BROADPHASE | OverflowType.NARROWPHASE | OverflowType.CCD))

SUCCESS_RULE = (
    f"more than {int(SUCCESS_STEPS)} steps of the episode are solved, in a row or not (MyoSuite's rule), and "
    "neither failure nor fault ends it"
)
"""When an episode counts as a success, for people."""
MYOSUITE = "success_myosuite"
"""Name of the figure by MyoSuite's rule alone, the paper's: more than 5 solved steps, failed or not."""

RESET_DISABLED = wp.constant(0)  # Gymnasium's autoreset modes
RESET_NEXT_STEP = wp.constant(1)
RESET_SAME_STEP = wp.constant(2)
AUTORESET = {
    "disabled": int(RESET_DISABLED),
    "next_step": int(RESET_NEXT_STEP),
    "same_step": int(RESET_SAME_STEP),
}


@wp.struct
class EpisodeState:
    """The place of every world in its episode; all arrays (num_worlds,).

    Attributes:
        step_count: Steps since reset.
        life_count: Steps since the world was seeded.
        solved_count: Steps since reset in which the task was solved.
        ended: The last step ended the episode, and the world is not reset yet.
    """

    step_count: wp.array[int]
    life_count: wp.array[int]
    solved_count: wp.array[int]
    ended: wp.array[bool]


@wp.struct
class Transition:
    """Results of one step of every world; arrays (num_worlds,), terms (num_worlds, num_terms).

    Attributes:
        obs: Observation, shape (num_worlds, obs_size).
        terms: Reward terms before weighting.
        reward: Weighted sum of the terms.
        solved: The task is solved in this state.
        failed: The task has failed in this state.
        success: The episode counts as a success so far: `SUCCESS_RULE`.
        terminated: The episode ended by failure or fault.
        truncated: The episode ended by its horizon.
        fault: Bits of `FAULTS`.
        fault_index: Where the bit for reward or observation is set: the term or column that is not finite.
    """

    obs: wp.array2d[float]
    terms: wp.array2d[float]
    reward: wp.array[float]
    solved: wp.array[bool]
    failed: wp.array[bool]
    success: wp.array[bool]
    terminated: wp.array[bool]
    truncated: wp.array[bool]
    fault: wp.array[int]
    fault_index: wp.array[int]


@wp.struct
class Masks:
    """Masks of worlds for the later kernels of a step; all arrays (num_worlds,).

    Attributes:
        live: Stepped and healthy: observe and score the state reached.
        renew: A new episode opens now.
        reset: Its state is reset now.
        fresh: A new episode opens now, and is to be observed.
    """

    live: wp.array[bool]
    renew: wp.array[bool]
    reset: wp.array[bool]
    fresh: wp.array[bool]


def new_episode_state(num_worlds: int) -> EpisodeState:
    """Return counters on the current Warp device, all 0."""
    return zeros_of(EpisodeState, num_worlds)


def new_transition(num_worlds: int, obs_size: int, num_terms: int) -> Transition:
    """Return step results on the current Warp device, all 0."""
    obs, terms = (num_worlds, obs_size), (num_worlds, num_terms)
    return zeros_of(Transition, num_worlds, obs=obs, terms=terms)


def new_masks(num_worlds: int) -> Masks:
    """Return masks on the current Warp device, all False."""
    return zeros_of(Masks, num_worlds)


@wp.kernel(enable_backward=False)
def count_step(
    # Out:
    episode: EpisodeState,
):
    """step_count += 1, life_count += 1."""
    worldid = wp.tid()
    episode.step_count[worldid] += 1
    episode.life_count[worldid] += 1


@wp.func_native("""
const float* row = &wp::index(values, worldid, 0);
bool found = false;
for (int i = 0; i < values.shape[1]; ++i)
    found |= !(wp::abs(row[i]) <= limit);
return found;
""")
def beyond(values: wp.array2d[float], worldid: int, limit: float) -> bool:
    """Return whether an entry of a world exceeds a limit, or is NaN; native, which becomes SIMD."""
    ...


@wp.kernel(enable_backward=False)
def detect_faults(
    # Data in:
    qpos_in: wp.array2d[float],
    qvel_in: wp.array2d[float],
    # In:
    ended: wp.array[bool],
    autoreset: int,
    # Data out:
    overflow_out: wp.array[int],
    # Out:
    fault: wp.array[int],
    live: wp.array[bool],
):
    """Add fault bits for states that are not finite and for capacities that overflowed; note who is live.

    Last of the checks of the state: a world is live that no check has marked and that is not only renewed.
    """
    worldid = wp.tid()
    bits = fault[worldid]
    if beyond(qpos_in, worldid, STATE_LIMIT) or beyond(qvel_in, worldid, STATE_LIMIT):
        bits |= FAULT_NONFINITE
    if (overflow_out[worldid] & ROW_BITS) != 0:
        bits |= FAULT_ROWS
    if (overflow_out[worldid] & CONTACT_BITS) != 0:
        bits |= FAULT_CONTACTS
    overflow_out[worldid] = 0
    fault[worldid] = bits
    live[worldid] = bits == 0 and (not ended[worldid] or autoreset == RESET_DISABLED)


@wp.kernel(enable_backward=False)
def detect_state_faults(
    # In:
    state: wp.array2d[float],
    # Out:
    fault: wp.array[int],
):
    """Add the fault bit for state beside qpos and qvel that is not finite."""
    worldid = wp.tid()
    if beyond(state, worldid, STATE_LIMIT):
        fault[worldid] = fault[worldid] | FAULT_NONFINITE


@wp.kernel(enable_backward=False)
def publish_observation(
    # In:
    mask: wp.array[bool],
    draft: wp.array2d[float],
    # Out:
    obs: wp.array2d[float],
    fault: wp.array[int],
    fault_index: wp.array[int],
):
    """obs = draft in the worlds of the mask where draft is finite; others keep theirs, with a fault bit."""
    worldid = wp.tid()
    if mask[worldid]:
        if beyond(draft, worldid, LARGEST):
            fault[worldid] = fault[worldid] | FAULT_OBSERVATION
            column = int(0)
            while wp.isfinite(draft[worldid, column]):
                column += 1
            fault_index[worldid] = column
        else:
            pack(obs, worldid, 0, draft, 1.0)


@wp.func
def first_not_finite(weights: wp.array[float], terms: wp.array2d[float], worldid: int) -> int:
    """Least k for which the sum of weights . terms up to k is not finite."""
    total = float(0.0)
    for k in range(weights.shape[0]):
        total += weights[k] * terms[worldid, k]
        if not wp.isfinite(total):
            return k
    return -1


@wp.kernel(enable_backward=False)
def advance_episode(
    # Params:
    weights: wp.array[float],
    horizon: wp.array[int],
    autoreset: int,
    keep_state: bool,
    # Out:
    episode: EpisodeState,
    transition: Transition,
    masks: Masks,
):
    """reward = weights . terms; decide what ends, what is reset and what is observed.

    A world that had ended is only renewed: reset, unless states carry over (`keep_state`). A faulty world -
    one whose reward is not finite is another - ends with reward 0, keeps its last healthy observation and is
    reset at once, in every mode.
    """
    worldid = wp.tid()
    had_ended = episode.ended[worldid] and autoreset != RESET_DISABLED
    if had_ended:
        transition.fault[worldid] = 0
    reward = float(0.0)
    if not had_ended and transition.fault[worldid] == 0:
        for k in range(weights.shape[0]):
            reward += weights[k] * transition.terms[worldid, k]
        if not wp.isfinite(reward):
            reward = 0.0
            transition.fault[worldid] = FAULT_REWARD
            transition.fault_index[worldid] = first_not_finite(weights, transition.terms, worldid)
    faulty = transition.fault[worldid] != 0
    live = not had_ended and not faulty
    if not live:
        for k in range(weights.shape[0]):
            transition.terms[worldid, k] = 0.0
    solved = live and transition.solved[worldid]
    if solved:
        episode.solved_count[worldid] += 1
    terminated = faulty or (live and transition.failed[worldid])
    truncated = not had_ended and episode.step_count[worldid] >= horizon[0]
    ended = terminated or truncated
    reset_now = ended and autoreset == RESET_SAME_STEP

    transition.reward[worldid] = reward
    transition.solved[worldid] = solved
    enough = not had_ended and episode.solved_count[worldid] > SUCCESS_STEPS
    transition.success[worldid] = enough and not terminated
    transition.terminated[worldid] = terminated
    transition.truncated[worldid] = truncated
    episode.ended[worldid] = ended and not reset_now
    masks.live[worldid] = live
    masks.renew[worldid] = had_ended or faulty or reset_now
    masks.reset[worldid] = faulty or ((had_ended or reset_now) and not keep_state)
    masks.fresh[worldid] = had_ended or reset_now


@wp.kernel(enable_backward=False)
def keep_final(
    # Out:
    transition: Transition,
    final: Transition,
):
    """Copy what a finished episode ended with, and clear what its reset in the same step voids.

    Rows of other worlds become 0. The fault stays visible in the transition.
    """
    worldid = wp.tid()
    ended = transition.terminated[worldid] or transition.truncated[worldid]
    for i in range(transition.obs.shape[1]):
        final.obs[worldid, i] = wp.where(ended, transition.obs[worldid, i], 0.0)
    for k in range(transition.terms.shape[1]):
        final.terms[worldid, k] = wp.where(ended, transition.terms[worldid, k], 0.0)
        transition.terms[worldid, k] = wp.where(ended, 0.0, transition.terms[worldid, k])
    final.solved[worldid] = ended and transition.solved[worldid]
    final.success[worldid] = ended and transition.success[worldid]
    final.fault[worldid] = wp.where(ended, transition.fault[worldid], 0)
    final.fault_index[worldid] = transition.fault_index[worldid]
    transition.solved[worldid] = transition.solved[worldid] and not ended
    transition.success[worldid] = transition.success[worldid] and not ended


@wp.kernel(enable_backward=False)
def open_episode(
    # In:
    renew: wp.array[bool],
    asked: bool,
    # Out:
    episode: EpisodeState,
    keys: RandomKeys,
):
    """Put the counters of the worlds to renew to 0; a reset that was asked for opens what had ended.

    The next episode's random numbers are other ones.
    """
    worldid = wp.tid()
    if renew[worldid]:
        episode.step_count[worldid] = 0
        episode.solved_count[worldid] = 0
        keys.episode[worldid] += 1
        if keys.episode[worldid] == 1:
            episode.life_count[worldid] = 0
        if asked:
            episode.ended[worldid] = False
