"""The paper's Figures 6, 7 and 8, from a synthetic recording and the simulated `paper` rig.

    response.py: a sweep through the rig --------------------------> Figure 6
    recording.py: a made recording ---> units.py: one unit --------> Figure 7
                                   `--> felt.py: vibration, twin --> Figure 8, with damping again

table.py writes each figure's numbers; figure6.py, figure7.py and figure8.py draw them, with
layout.py for what they share; everything.py makes all of it. Those need matplotlib: import late.
"""
