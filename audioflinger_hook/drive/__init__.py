"""Vibration to actuators: the core's drives for Python.

| module        | holds                                                                          |
| ------------- | ------------------------------------------------------------------------------ |
| drive.py      | `Drive`: the drives of one device's actuators                                  |
| driven_rig.py | `DrivenRig`: what the core says of the actuators that drive one rig            |
| rig_driver.py | `RigDriver`: one rig alone                                                     |

What is done for a rig is designed in device/drive and computed in core/drive.
"""
