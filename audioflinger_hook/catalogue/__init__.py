"""Renders the vibration of whole sound libraries, on one machine or many.

    manifest -> items -> run -> pool or cluster -> work -> storage
                          '--> summary

| module | what it does |
| --- | --- |
| `addresses` | paths and URLs; removes credentials from texts |
| `item`, `manifest`, `listing` | reading and checking the items of a catalogue |
| `recipe` | the options of a run, and a key that changes with them |
| `storage` | sounds and results, local or remote; incomplete results never appear |
| `measures` | exposure to a vibration, and its peaks over time |
| `work` | one item: finding out its state, reading its sound, rendering it, writing its record |
| `run`, `cluster` | batches of items in local processes (`offline/batch.py`) or on a Dask cluster |
| `summary` | the report of a run, and its page of pictures |
"""
