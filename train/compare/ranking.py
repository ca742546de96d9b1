"""Best policy of each scenario, and policies tied with it."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rendezvous_env.scenario.scenario import Scenario

from .. import policies
from .evaluation import Episodes, starts_of
from .playing import Played, by_scenario
from .statistics import best_policy, collision_free_difference

_MOST_NAMED = 4
"""Maximum number of tied policies named in the summary."""
ONE_START, NONE_MET = "one episode is not conclusive", "no policy met without a collision"
"""Reasons why a scenario has no best policy."""


@dataclass(frozen=True)
class Ranking:
    """Ranking of policies on one scenario by collision-free success."""

    scenario: str
    count: int
    share: dict[str, float]  # collision-free success, 0 to 1; NaN where contacts do not count
    best: str | None  # among policies that are not oracles
    tied: tuple[str, ...]
    """Policies whose paired difference from the best has an interval that contains 0."""
    references: tuple[str, ...]
    """Oracles, which are shown but not ranked."""
    undecided: str = ""
    """Reason why there is no best policy, where policies compete: ONE_START or NONE_MET."""

    @property
    def is_contest(self) -> bool:
        """True if policies compete on the scenario."""
        return self.best is not None and len(self.share) - len(self.references) > 1

    @property
    def top(self) -> tuple[str, ...]:
        """The best policy and those tied with it."""
        return () if self.best is None else (self.best, *self.tied)


def rank(played: Sequence[Played]) -> list[Ranking]:
    """Rankings of all scenarios, in order."""
    drawn = {done.job.scenario.name: done.job.scenario for done in played}
    kinds = {done.job.name: policies.kind_of(done.job.policy) for done in played}
    return [_rank_one(drawn[name], own, kinds) for name, own in by_scenario(played).items()]


def _rank_one(
    scenario: Scenario, episodes: dict[str, Episodes], kinds: Mapping[str, str]
) -> Ranking:
    """Ranking of the policies on one scenario; ``kinds`` by name."""
    share = {name: float(own.collision_free.mean()) for name, own in episodes.items()}
    references = tuple(name for name in episodes if kinds[name] == "privileged")
    competing = {name: own for name, own in episodes.items() if name not in references}
    count = len(next(iter(episodes.values())).collision_free)
    best, undecided = None, ""
    if competing and not np.isnan(list(share.values())).any():
        best = best_policy(competing)
        if count < starts_of(scenario, 2):
            best, undecided = None, ONE_START
        elif share[best] == 0.0:
            best, undecided = None, NONE_MET
    tied = () if best is None else _tied(best, competing)
    undecided = undecided if len(competing) > 1 else ""
    return Ranking(scenario.name, count, share, best, tied, references, undecided)


def _tied(best: str, competing: dict[str, Episodes]) -> tuple[str, ...]:
    """Policies whose paired interval of the difference from the best contains 0."""
    found = []
    for name in (name for name in competing if name != best):
        difference, (low, high) = collision_free_difference(competing[name], competing[best])
        if difference == 0 or low <= 0 <= high:  # no interval for one episode
            found.append(name)
    return tuple(found)


def answer(rankings: Sequence[Ranking]) -> str:
    """One-sentence summary of the leading policies."""
    contests = [ranking for ranking in rankings if ranking.is_contest]
    if not contests:
        return f"No ranking: {_why_undecided(rankings)}."
    tops, alone = _counts(contests)
    order = leaders(rankings)
    leader = order[0]
    level = [name for name in order if (tops[name], alone[name]) == (tops[leader], alone[leader])]
    count, total = tops[leader], len(contests)
    all_of = f"{count} of {total} scenarios" if total > 1 else "the one scenario with a choice"
    where = f"best, or tied with the best, in {all_of}"
    if len(level) > 1:
        many = len(level) > _MOST_NAMED
        listed = f"{len(level)} policies" if many else f"{', '.join(level[:-1])} and {level[-1]}"
        return f"{listed} are tied in collision-free success: {where}."
    by_itself = f", alone in {alone[leader]}" if alone[leader] and len(contests) > 1 else ""
    then = f"; then {order[1]}, in {tops[order[1]]}" if len(order) > 1 else ""
    return f"{leader} leads in collision-free success: {where}{by_itself}{then}."


def _why_undecided(rankings: Sequence[Ranking]) -> str:
    reasons = {ranking.undecided for ranking in rankings}
    if reasons == {ONE_START}:
        return "one episode of a random scenario is not conclusive; use more --episodes"
    if reasons == {NONE_MET}:
        return "no policy met without a collision in any episode"
    return "no scenario has two policies that can meet without a collision"


def leaders(rankings: Sequence[Ranking]) -> list[str]:
    """Policies that lead or tie in a scenario, sorted by the number of scenarios."""
    tops, alone = _counts([ranking for ranking in rankings if ranking.is_contest])
    return sorted(tops, key=lambda name: (-tops[name], -alone[name]))


def _counts(contests: Sequence[Ranking]) -> tuple[Counter[str], Counter[str]]:
    """Number of scenarios that each policy leads or ties, and leads alone."""
    tops = Counter(name for ranking in contests for name in ranking.top)
    return tops, Counter(ranking.top[0] for ranking in contests if not ranking.tied)
