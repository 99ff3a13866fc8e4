"""The bench: speed and error of the transform and of the simulated rig, measured on this machine.

    sounds, subjects, baselines -> sections (with cost, measures) -> report -> Markdown, JSON
    records of soaks and of live latency --'                           '-> figures

| folder | content |
| --- | --- |
| sounds | signals by formula, recordings, and real sounds in classes |
| baselines | other methods from sound to vibration |
| measures | error, similarity, lag and felt strength of a vibration; loudness; large bursts |
| sections | one function a section of the report |
| figures | the pictures of a report |

`python -m tools.bench.real_sounds` measures only what is felt of real sounds, for chosen profiles.

`python -m tools.bench` measures everything; `run.run_bench` does the same from Python.
"""
