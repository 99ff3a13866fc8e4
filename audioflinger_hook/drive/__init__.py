"""Vibration to actuators: the core's drives for Python.

| module        | holds                                                                          |
| ------------- | ------------------------------------------------------------------------------ |
| drive.py      | `Drive`: the drives of one device's actuators                                  |
| driven_rig.py | `DrivenRig`: what the core says of the actuators that drive one rig            |

device/drive designs the processing of a rig; core/drive computes it.
"""
