"""The analytic policy bearing-only."""

from ..rules import rule

ALGORITHM = rule("bearing-only", "law (1)", "heading")
