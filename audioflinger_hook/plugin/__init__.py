"""The transform as a LADSPA and LV2 plugin for other audio software."""
