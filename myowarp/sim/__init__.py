"""A task built on a device and stepped: worlds, random starts, signals, arrays in and out."""
