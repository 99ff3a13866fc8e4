"""Whole libraries of sound, on one machine or many.

    manifest -> items -> run -> pool or cluster -> work -> storage
                          '--> summary

| module | what it does |
| --- | --- |
| `addresses` | paths and URLs; removes credentials from texts |
| `item`, `manifest`, `listing` | the items of a catalogue, streamed and checked |
| `recipe` | how results are made, and the key of a result |
| `storage` | sounds and results, here or remote; whole files or none |
| `measures` | exposure and course of a vibration |
| `work` | one item: its state, record, reading, export |
| `run`, `cluster` | the run itself; batches on a Dask cluster (`offline/pool.py`: in processes) |
| `summary` | the report of a run, and its page of pictures |
"""
