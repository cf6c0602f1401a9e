"""Device code shared by two or more owners. Every piece of arithmetic stands here once."""
