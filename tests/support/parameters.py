from audioflinger_hook.transform import TransformParameters
from device.values import Choice, Number

LIMITS = {
    name: described
    for name, described in TransformParameters.DESCRIPTIONS.items()
    if isinstance(described, Number)
}
CHOICES = {
    name: described
    for name, described in TransformParameters.DESCRIPTIONS.items()
    if isinstance(described, Choice)
}
TWO_SHAKERS = """\
[[actuator]]
source = "left"
channels = [0]

[[actuator]]
source = "right"
channels = [1]
"""
