"""Muscle conditions; a new one is one file here and one import below.

gymnasium.make_vec("MyoWarp/myoHandPoseRandom-v1", 256, conditions=("sarcopenia", TendonTear("FPL")))
"""

from myowarp.definitions.condition import CONDITIONS, Condition, Effect, Phase, resolve
from myowarp.definitions.parameter import Ramp, Uniform
from myowarp.models.conditions.exoskeleton import Exoskeleton
from myowarp.models.conditions.fatigue_3ccr import Fatigue3CCR
from myowarp.models.conditions.fatigue_ma2009 import FatigueMa2009
from myowarp.models.conditions.joint_device import JointDevice
from myowarp.models.conditions.load import Load
from myowarp.models.conditions.motor_noise import MotorNoise
from myowarp.models.conditions.nerve_crossing import NerveCrossing
from myowarp.models.conditions.pelvis_support import PelvisSupport
from myowarp.models.conditions.reafferentation import Reafferentation
from myowarp.models.conditions.sarcopenia import Sarcopenia
from myowarp.models.conditions.stretch_reflex import StretchReflex
from myowarp.models.conditions.tendon_tear import TendonTear
from myowarp.models.conditions.tendon_transfer import TendonTransfer

__all__ = [
    "CONDITIONS",
    "Condition",
    "Effect",
    "Exoskeleton",
    "Fatigue3CCR",
    "FatigueMa2009",
    "JointDevice",
    "Load",
    "MotorNoise",
    "NerveCrossing",
    "PelvisSupport",
    "Phase",
    "Ramp",
    "Reafferentation",
    "Sarcopenia",
    "StretchReflex",
    "TendonTear",
    "TendonTransfer",
    "Uniform",
    "resolve",
]
