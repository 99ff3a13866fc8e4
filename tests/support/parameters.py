"""The transform's parameters by kind: numbers with their ranges, and words with their choices."""

from __future__ import annotations

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
