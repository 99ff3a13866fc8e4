"""The effect as a plugin of other audio software: LADSPA and LV2."""
