"""Python's collection of garbage, kept out of the way of sound.

A whole collection looks at every object that there is: some 50 ms with all libraries loaded, in
which no thread runs. That it rarely happens makes it no better. What is never let go of need not be
looked at, and that is nearly all: a collection of the rest takes 0.1 ms.
"""

from __future__ import annotations

import gc


def spare_what_is_there() -> None:
    """Let later collections look at new objects alone.

    Takes as long as a whole collection: call it once everything is loaded, and again when more was
    loaded, while no sound is played. Any thread.
    """
    gc.collect()
    gc.freeze()
