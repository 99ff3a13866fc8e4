"""The bench: speed and error of the transform and of the simulated rig, measured on this machine.

    sounds, subjects, baselines -> sections (with cost, measures) -> report -> Markdown, JSON
    records of soaks and of live latency --'                           '-> figures

| folder | content |
| --- | --- |
| sounds | signals by formula, recordings, real sounds in classes, and films made of them |
| baselines | other methods from sound to vibration |
| measures | error, similarity, lag and felt strength of a vibration; loudness; large bursts |
| sections | one function a section of the report |
| figures | the pictures of a report |

`python -m tools.bench.films` measures only what is felt of films and real sounds: of chosen
profiles, or of any function from sound to vibration.

`python -m tools.bench` measures everything; `run.run_bench` does the same from Python.
"""
