"""The analytic policy tangent-joined-tuned."""

from ..rules import rule

ALGORITHM = rule("tangent-joined-tuned", "rule", "heading")
