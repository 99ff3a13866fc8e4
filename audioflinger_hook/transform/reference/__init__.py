"""The reference form: the paper's equations literally, unit by unit."""

from audioflinger_hook.transform.reference.transform import ReferenceTransform

__all__ = ["ReferenceTransform"]
