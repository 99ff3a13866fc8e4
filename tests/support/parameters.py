from audioflinger_hook.transform import TransformParameters
from device.values import Choice, Number
from tests.support.data import text

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
TWO_SHAKERS = text("two-shakers.toml")
