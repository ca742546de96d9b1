"""The analytic policy tank-joined."""

from ..rules import rule

ALGORITHM = rule("tank-joined", "rule", "tank")
