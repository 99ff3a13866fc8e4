"""Whole libraries of sound, on one machine or many.

    manifest -> items -> run -> executors -> work -> storage
                          '--> summary, page

| module | what it does |
| --- | --- |
| `addresses` | paths and URLs; removes credentials from texts |
| `item`, `manifest`, `listing` | the items of a catalogue, streamed and checked |
| `recipe` | how results are made, and the key of a result |
| `storage` | sounds and results, here or remote; whole files or none |
| `measures` | exposure and course of a vibration |
| `work` | one item: record, reading, export |
| `executors`, `run` | where batches run, and the run itself |
| `summary`, `page`, `status` | what came of a run |
"""
