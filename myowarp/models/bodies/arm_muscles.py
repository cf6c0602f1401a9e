"""Muscles of the human arm by the names that MyoSuite's and OpenSim's models give them: facts of our bodies.

Each is in the group of its principal anatomical action. Flexors, extensors and pronators from the elbow on
are so by the moment arms of the models too (tests/suite/test_signals.py). Muscles of the fingers are
abbreviated as in Lee et al. (2015), doi:10.1371/journal.pone.0121712: RI radial interosseous, UI_UB ulnar
interosseous, LU_RB lumbrical. Fatigue rates: Rakshit et al. (2021), doi:10.1016/j.jbiomech.2021.110695,
table 2, both sexes together. Shoulder: Frey-Law et al. (2012), doi:10.1016/j.jbiomech.2012.04.018, table 1,
with r = 15 of Looft et al. (2018), doi:10.1016/j.jbiomech.2018.06.005. MyoSuite 3.0.0 has the same, and
gives SUP those of an extensor.
"""

from myowarp.definitions.body import FatigueRates
from myowarp.models.bodies.by_muscle import by_muscle

HAND = FatigueRates(0.01227, 0.00134, 9.1)
ELBOW_EXTENSOR = FatigueRates(0.01559, 0.00125, 25.52)
ELBOW_FLEXOR = FatigueRates(0.01703, 0.00494, 4.68)
WRIST_FLEXOR = FatigueRates(0.01235, 0.00135, 12.51)
SHOULDER = FatigueRates(0.0182, 0.00168, 15.0)
FIRST_DORSAL_INTEROSSEOUS = FatigueRates(0.02686, 0.00656, 3.41)


GROUPS = by_muscle(
    {
        "shoulder flexors": "DELT1 PECM1 CORB",
        "shoulder abductors": "DELT2 SUPSP",
        "shoulder extensors": "DELT3 LAT1 LAT2 LAT3 TMAJ",
        "shoulder adductors": "PECM2 PECM3",
        "shoulder external rotators": "INFSP TMIN",
        "shoulder internal rotators": "SUBSC",
        "elbow extensors": "TRIlong TRIlat TRImed ANC",
        "elbow flexors": "BIClong BICshort BRA BRD",
        "forearm pronators": "PT PQ",
        "forearm supinators": "SUP",
        "wrist extensors": "ECRL ECRB ECU",
        "wrist flexors": "FCR FCU PL",
        "finger extensors": "EDC5 EDC4 EDC3 EDC2 EDM EIP",
        "finger flexors": "FDS5 FDS4 FDS3 FDS2 FDP5 FDP4 FDP3 FDP2",
        "finger intrinsics": "RI2 LU_RB2 UI_UB2 RI3 LU_RB3 UI_UB3 RI4 LU_RB4 UI_UB4 RI5 LU_RB5 UI_UB5",
        "thumb extensors": "EPL EPB",
        "thumb flexors": "FPL",
        "thumb abductors": "APL",
        "thumb opposers": "OP",
    }
)

FATIGUE_RATES = by_muscle(
    {
        SHOULDER: "DELT1 DELT2 DELT3 SUPSP INFSP SUBSC TMIN TMAJ PECM1 PECM2 PECM3 LAT1 LAT2 LAT3 CORB",
        ELBOW_EXTENSOR: "TRIlong TRIlat TRImed ANC SUP",
        ELBOW_FLEXOR: "BIClong BICshort BRA BRD PT",
        WRIST_FLEXOR: "FCR FCU PL PQ FDS5 FDS4 FDS3 FDS2 FDP5 FDP4 FDP3 FDP2 FPL APL",
        FIRST_DORSAL_INTEROSSEOUS: "RI2",
        HAND: "ECRL ECRB ECU EDC5 EDC4 EDC3 EDC2 EDM EIP EPL EPB "
        "OP LU_RB2 UI_UB2 RI3 LU_RB3 UI_UB3 RI4 LU_RB4 UI_UB4 RI5 LU_RB5 UI_UB5",
    }
)
