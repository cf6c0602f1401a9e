"""Studies of recorded motions: a table of trials, and draws of what is uncertain in each."""
