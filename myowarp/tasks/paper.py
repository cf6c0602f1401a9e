"""The paper's grid of 204 tasks: nine families, easy and hard, three resets, muscle conditions.

Source: Caggiano et al. (2022), arXiv:2205.13600, table of tasks: six hand families and the elbow under four
conditions each, the two finger families under three. *Easy* is the family's fixed task, *hard* its random
one; of the baoding balls easy is the swap that the paper's text describes. Upstream never registered the
reset axis nor the full grid: the grid's ids are ours and mean the corrected version of every task, while ids
that upstream has keep upstream's meaning.

The paper's k = 1 of fatigue has no unit. It is 1/s here: in 1/min, the unit of the model's authors, a muscle
that is driven fully loses 3 % in an episode of 2 s, and two thirds of the fatigue cells would change next to
nothing.
"""

from dataclasses import dataclass
from itertools import product

from myowarp.definitions.task import TASKS

HAND_CONDITIONS = ("none", "sarcopenia", "fatigue", "tendon_transfer")
ELBOW_CONDITIONS = ("none", "sarcopenia", "fatigue", "exoskeleton")
FINGER_CONDITIONS = ("none", "sarcopenia", "fatigue")

FAMILIES = {
    # family: (easy task, hard task, conditions)
    "FingerReach": ("myoFingerReachFixed-v0", "myoFingerReachRandom-v0", FINGER_CONDITIONS),
    "FingerPose": ("myoFingerPoseFixed-v0", "myoFingerPoseRandom-v0", FINGER_CONDITIONS),
    "ElbowPose": ("myoElbowPose1D6MFixed-v0", "myoElbowPose1D6MRandom-v0", ELBOW_CONDITIONS),
    "HandPose": ("myoHandPoseFixed-v1", "myoHandPoseRandom-v1", HAND_CONDITIONS),
    "HandReach": ("myoHandReachFixed-v1", "myoHandReachRandom-v1", HAND_CONDITIONS),
    "HandKeyTurn": ("myoHandKeyTurnFixed-v1", "myoHandKeyTurnRandom-v1", HAND_CONDITIONS),
    "HandObjHold": ("myoHandObjHoldFixed-v1", "myoHandObjHoldRandom-v1", HAND_CONDITIONS),
    "HandPenTwirl": ("myoHandPenTwirlFixed-v1", "myoHandPenTwirlRandom-v1", HAND_CONDITIONS),
    "HandBaoding": ("myoHandBaodingSwap-v0", "myoHandBaodingRandom-v1", HAND_CONDITIONS),
}
IN_OUR_NAMES = {
    "none": (),
    "sarcopenia": ("sarcopenia",),
    "fatigue": ("fatigue_ma2009(rate=60)",),  # k = 1/s
    "tendon_transfer": ("tendon_transfer",),
    "exoskeleton": ("exoskeleton",),
}
DIFFICULTIES = ("easy", "hard")
RESETS = {"F": "fixed", "R": "random", "N": "none"}
SUFFIXES = {
    "none": "",
    "sarcopenia": "Sarc",
    "fatigue": "Fati",
    "tendon_transfer": "Tend",
    "exoskeleton": "Exo",
}


@dataclass(frozen=True)
class PaperTask:
    """One cell of the grid.

    Attributes:
        id: Gymnasium id, such as `MyoWarp/paperHandPoseEasyFSarc-v0`.
        family: Row of the paper's table.
        difficulty: "easy" or "hard".
        reset: "fixed", "random" or "none" (reset-free).
        condition: Muscle condition, in the paper's words.
        task: The registered task that it varies.
    """

    id: str
    family: str
    difficulty: str
    reset: str
    condition: str
    task: str

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names in `CONDITIONS`, with values that are not the default."""
        return IN_OUR_NAMES[self.condition]


def grid() -> tuple[PaperTask, ...]:
    """Return all 204 tasks, in the order of the paper's table."""
    rows = []
    for family, (easy, hard, conditions) in FAMILIES.items():
        for difficulty, (letter, reset), condition in product(DIFFICULTIES, RESETS.items(), conditions):
            name = f"paper{family}{difficulty.capitalize()}{letter}{SUFFIXES[condition]}-v0"
            task = easy if difficulty == "easy" else hard
            rows.append(PaperTask(f"MyoWarp/{name}", family, difficulty, reset, condition, TASKS[task].key))
    return tuple(rows)
