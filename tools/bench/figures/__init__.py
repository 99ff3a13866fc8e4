"""The pictures of a report: `pictures` lists them, `sheet` has what they share. Needs matplotlib.

Only `pictures` may be imported where matplotlib is not installed.
"""
