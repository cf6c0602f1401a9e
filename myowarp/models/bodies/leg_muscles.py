"""Muscles of the leg by the names of Rajagopal et al. (2016), doi:10.1109/TBME.2016.2586891.

Each is in the group of its principal anatomical action. Fatigue rates are those of MyoSuite 3.0.0, which
names Rakshit et al. (2021), doi:10.1016/j.jbiomech.2021.110695, and Looft et al. (2018),
doi:10.1016/j.jbiomech.2018.06.005: extensors of the knee, dorsiflexors and plantarflexors. The others tire at
the general rates.
"""

from myowarp.definitions.body import FatigueRates
from myowarp.models.bodies.by_muscle import by_muscle, grouped_by_side, on_both_sides

KNEE_EXTENSOR = FatigueRates(0.00825, 0.00076, 14.85)
DORSIFLEXOR = FatigueRates(0.00828, 0.00204, 7.07)
PLANTARFLEXOR = FatigueRates(0.00695, 0.00096, 15.0)

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
            KNEE_EXTENSOR: "recfem vasint vaslat vasmed",
            DORSIFLEXOR: "tibant edl ehl",
            PLANTARFLEXOR: "gaslat gasmed soleus tibpost perbrev perlong fdl fhl",
        }
    )
)
