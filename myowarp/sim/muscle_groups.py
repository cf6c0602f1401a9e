"""What the muscles of our bodies do, by name: each is in the group of its principal anatomical action.

Flexors, extensors and pronators are so by the moment arms of the models too (tests/suite/test_signals.py).
Muscles of the fingers are abbreviated as in Lee et al. (2015), doi:10.1371/journal.pone.0121712: RI radial
interosseous, UI_UB ulnar interosseous, LU_RB lumbrical. Those of the model finger are named after what they
do.
"""

GROUPS = {
    "elbow extensors": "TRIlong TRIlat TRImed",
    "elbow flexors": "BIClong BICshort BRA",
    "forearm pronators": "PT PQ",
    "wrist extensors": "ECRL ECRB ECU",
    "wrist flexors": "FCR FCU PL",
    "finger extensors": "EDC5 EDC4 EDC3 EDC2 EDM EIP extn",
    "finger flexors": "FDS5 FDS4 FDS3 FDS2 FDP5 FDP4 FDP3 FDP2 mflx dflx",
    "finger intrinsics": "RI2 LU_RB2 UI_UB2 RI3 LU_RB3 UI_UB3 RI4 LU_RB4 UI_UB4 RI5 LU_RB5 UI_UB5",
    "finger abductors": "adabR adabL",
    "thumb extensors": "EPL EPB",
    "thumb flexors": "FPL",
    "thumb abductors": "APL",
    "thumb opposers": "OP",
}
"""Group: its muscles, without the side suffix `_r`."""

_GROUP_OF = {muscle: group for group, muscles in GROUPS.items() for muscle in muscles.split()}


def group_of(muscle: str) -> str:
    """Return the group of a muscle, with or without the side suffix `_r`; "" for a name not in the table."""
    return _GROUP_OF.get(muscle.removesuffix("_r"), "")
