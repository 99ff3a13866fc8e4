"""Benchmarks of the transform from sound to vibration, and of the simulated rig.

    `sounds`: synthetic signals, recordings, and films composed of recorded sounds.
    `baselines`: other methods of converting sound to vibration.
    `measures`: functions that compute properties of sounds, vibrations and rigs.
    `sections`: one function for each section of the report.
    `figures`: the pictures of the report.

`python -m tools.bench` makes the whole report; in Python, call `run.run_bench`. `python -m
tools.bench.films` measures only the vibration of films and recorded sounds, for chosen profiles or
for any function that converts sound to vibration.
"""
