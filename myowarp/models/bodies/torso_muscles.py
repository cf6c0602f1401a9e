"""Muscles of the trunk by the names of SimTK's Constrained Lumbar Spine model 210, grouped by muscle.

They have no fatigue rates of their own, and tire at the general ones, as in MyoSuite 3.0.0. Those of the
trunk are F = 0.00755, R = 0.00075 per s (Frey-Law et al. 2012, doi:10.1016/j.jbiomech.2012.04.018, table 1).
"""

from myowarp.models.bodies.by_muscle import by_muscle, grouped_by_side

RIGHT = by_muscle(
    {
        "psoas": "Ps_L1_VB Ps_L1_TP Ps_L1_L2_IVD Ps_L2_TP Ps_L2_L3_IVD Ps_L3_TP Ps_L3_L4_IVD Ps_L4_TP "
        "Ps_L4_L5_IVD Ps_L5_TP Ps_L5_VB",
        "rectus abdominis": "rect_abd",
        "iliocostalis": "IL_L1 IL_L2 IL_L3 IL_L4 IL_R5 IL_R6 IL_R7 IL_R8 IL_R9 IL_R10 IL_R11 IL_R12",
        "longissimus": "LTpT_T1 LTpT_T2 LTpT_T3 LTpT_T4 LTpT_T5 LTpT_T6 LTpT_T7 LTpT_T8 LTpT_T9 LTpT_T10 "
        "LTpT_T11 LTpT_T12 LTpT_R4 LTpT_R5 LTpT_R6 LTpT_R7 LTpT_R8 LTpT_R9 LTpT_R10 LTpT_R11 LTpT_R12 "
        "LTpL_L5 LTpL_L4 LTpL_L3 LTpL_L2 LTpL_L1",
        "quadratus lumborum": "QL_post_I.1-L3 QL_post_I.2-L4 QL_post_I.2-L3 QL_post_I.2-L2 QL_post_I.3-L1 "
        "QL_post_I.3-L2 QL_post_I.3-L3 QL_mid_L3-12.3 QL_mid_L3-12.2 QL_mid_L3-12.1 QL_mid_L2-12.1 "
        "QL_mid_L4-12.3 QL_ant_I.2-T12 QL_ant_I.3-T12 QL_ant_I.2-12.1 QL_ant_I.3-12.1 QL_ant_I.3-12.2 "
        "QL_ant_I.3-12.3",
        "multifidus": "MF_m1s MF_m1t.1 MF_m1t.2 MF_m1t.3 MF_m2s MF_m2t.1 MF_m2t.2 MF_m2t.3 MF_m3s MF_m3t.1 "
        "MF_m3t.2 MF_m3t.3 MF_m4s MF_m4t.1 MF_m4t.2 MF_m4t.3 MF_m5s MF_m5t.1 MF_m5t.2 MF_m5t.3 "
        "MF_m1.laminar MF_m2.laminar MF_m3.laminar MF_m4.laminar MF_m5.laminar",
        "erector spinae": "ercspn",
        "external oblique": "EO1 EO2 EO3 EO4 EO5 EO6 extobl",
        "internal oblique": "IO1 IO2 IO3 IO4 IO5 IO6 intobl",
    }
)

GROUPS = grouped_by_side(RIGHT)
