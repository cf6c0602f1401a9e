"""Training: PPO, TRPO, SAC and FlashSAC in a loop of ours, exact checkpoints, and evaluation.

| file | what it holds |
|---|---|
| `settings.py` | what a run can be told, presets of tasks |
| `plan.py` | a run that was asked for, checked before anything is built |
| `networks.py` | policies and value functions |
| `flash_sac.py` | FlashSAC, the agent of the hard contact tasks, on skrl's SAC |
| `agents.py` | skrl's agents from settings; all their numbers as named arrays, and back |
| `loop.py` | act, step, record, update, save, stop |
| `tally.py` | returns and successes of finished episodes |
| `checkpoint.py` | a folder of manifest and tensors: written whole, refused when damaged; needs no torch |
| `progress.py` | the live line, CSV, TensorBoard, the curve |
| `evaluate.py` | episodes of a checkpoint, three success rules; needs no torch |
| `command.py`, `eval_command.py` | `myowarp train` and `myowarp eval` |
"""
