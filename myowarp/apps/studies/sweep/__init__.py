"""`myowarp sweep`: a study of many runs over a Ray cluster, each done once.

study.py     what the YAML file says, as runs that were checked
work.py      what one run does, wherever it is sent
command.py   all runs: sent, counted, done again where a part died
report.py    the live table; table and plot of the study
"""
