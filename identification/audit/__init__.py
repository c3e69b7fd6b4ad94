"""The model you have against the arm you have: the fewest things in the set-up that are different, in numbers."""

from identification.audit.audit import audit
from identification.audit.difference import Audit, Difference

__all__ = ["Audit", "Difference", "audit"]
