"""Figures 6, 7 and 8 of the paper, from a synthetic recording and the simulated `paper` rig.

    response.py: a sweep through the rig --------------------------> Figure 6
    recording.py: synthetic recording -> units.py: one unit -------> Figure 7
                                    `--> felt.py: vibration, rig --> Figure 8, also with damping

table.py writes the numbers of each figure. figure6.py, figure7.py and figure8.py draw them, with
shared parts in layout.py. everything.py runs all of this. The modules that draw need matplotlib, so
import them only for drawing.
"""
