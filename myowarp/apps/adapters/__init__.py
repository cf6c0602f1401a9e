"""The vector environment as other trainers want it; each file needs its trainer installed."""
