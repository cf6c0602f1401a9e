"""Writes elbow_cohort.csv: a thousand made-up patients for `myowarp cohort`.

Nobody was measured. Strength and load are uniform, the fatigue rate scatters around that of elbow flexors
(0.017 1/s, Rakshit et al. 2021), a quarter each wears an exoskeleton of 0, 25, 50 or 100 %, one in five has
torn the long head of the biceps or the brachialis.
"""

import csv
from pathlib import Path

import numpy as np

rng = np.random.default_rng(2022)
with Path(__file__).with_suffix(".csv").open("w", newline="", encoding="utf-8") as file:
    table = csv.writer(file, lineterminator="\n")
    table.writerow(["patient", "strength", "fatigue_rate", "load_mass", "exo_assistance", "tendon_tear"])
    for number in range(1, 1001):
        strength, load = rng.uniform(0.2, 1.0), rng.uniform(0.0, 6.0)
        fatigue = 0.017 * np.exp(0.7 * rng.standard_normal())
        assistance = rng.choice([0.0, 0.25, 0.5, 1.0])
        tear = rng.choice(["", "BIClong", "BRA"], p=[0.8, 0.1, 0.1])
        numbers = (f"{strength:.2f}", f"{fatigue:.4f}", f"{load:.1f}", f"{assistance:g}")
        table.writerow([f"V{number:04d}", *numbers, tear])
