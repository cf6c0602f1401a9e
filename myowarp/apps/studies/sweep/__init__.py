"""`myowarp sweep`: a study of many runs over a Ray cluster, each done once.

study.py    the YAML file as checked runs
work.py     one run, on any node
run.py      all runs: sent, counted, repeated where a node died
report.py   the live table; table and plot of the study
"""
