"""Protection of a rig: the core (protection.c) computes a gain from the tables of design.py."""
