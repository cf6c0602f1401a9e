"""Training: PPO, TRPO, SAC and DAgger, each a file, and exact checkpoints.

| file | what it holds |
|---|---|
| `settings.py`, `bonus.py` | what a run can be told, presets of tasks; terms of the training's reward |
| `plan.py` | a run that was asked for, checked before anything is built |
| `worlds.py`, `starts.py`, `tally.py` | steps and restarts; where episodes start; figures of episodes |
| `ppo.py`, `trpo.py`, `sac.py`, `dagger.py`, `improve.py` | an algorithm each, from the first step on |
| `learner.py` | what they share: rates, optimisers, all numbers by name, the average of the policy |
| `networks.py`, `replay.py`, `arrays.py` | policies, critics, noise; a memory of samples; numbers by name |
| `loop.py`, `run.py` | a run between two iterations; from its first step to its report |
| `selection.py` | evaluations on the way, of which the best policy is kept |
"""
