"""Muscles of the leg by the names of Rajagopal et al. (2016), doi:10.1109/TBME.2016.2586891.

Each is in the group of its principal anatomical action. Fatigue rates: Frey-Law et al. (2012),
doi:10.1016/j.jbiomech.2012.04.018, table 1, knee and ankle, with r = 15 of Looft et al. (2018),
doi:10.1016/j.jbiomech.2018.06.005; there are none for the hip.
"""

from myowarp.definitions.body import FatigueRates
from myowarp.models.bodies.by_muscle import by_muscle, grouped_by_side, on_both_sides

KNEE = FatigueRates(0.015, 0.00149, 15.0)
ANKLE = FatigueRates(0.00589, 0.00058, 15.0)

GROUPS = grouped_by_side(
    by_muscle(
        {
            "hip flexors": "iliacus psoas sart",
            "hip extensors": "glmax1 glmax2 glmax3",
            "hip abductors": "glmed1 glmed2 glmed3 glmin1 glmin2 glmin3 tfl",
            "hip adductors": "addbrev addlong addmagDist addmagIsch addmagMid addmagProx grac",
            "hip external rotators": "piri",
            "knee extensors": "recfem vasint vaslat vasmed",
            "knee flexors": "bflh bfsh semimem semiten",
            "ankle plantarflexors": "gaslat gasmed soleus",
            "ankle dorsiflexors": "tibant",
            "ankle invertors": "tibpost",
            "ankle evertors": "perbrev perlong",
            "toe extensors": "edl ehl",
            "toe flexors": "fdl fhl",
        }
    )
)

FATIGUE_RATES = on_both_sides(
    by_muscle(
        {
            KNEE: "recfem vasint vaslat vasmed bflh bfsh semimem semiten",
            ANKLE: "gaslat gasmed soleus tibant tibpost perbrev perlong edl ehl fdl fhl",
        }
    )
)
