"""Named numbers and tables, as a design holds them."""

from __future__ import annotations

from device.units import FloatArray

Record = int | float | FloatArray
Records = dict[str, Record]  # counts, numbers and tables of float64, by name
