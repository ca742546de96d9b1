"""What the columns of the files of ``compare`` mean, in their order.

Those of episodes.csv are the fields of ``comparing.episodes.Episodes``, after scenario, policy and
start.
"""

_INTERVAL = "of the 95 % interval of the column before it; empty for a single start"

RESULTS = {
    "scenario": "name of the scenario",
    "policy": "name of the policy",
    "episodes": "number of starts",
    "success": "fraction of teams that met, 0 to 1",
    "success_low": f"lower end {_INTERVAL} (Wilson)",
    "success_high": "upper end of it",
    "clean_success": "fraction of teams that met without touching an obstacle; empty where robots "
    "pass through obstacles",
    "clean_low": f"lower end {_INTERVAL} (Wilson)",
    "clean_high": "upper end of it",
    "median_time": "median time of rendezvous, s; a time-out counts as later than any time",
    "time_low": f"lower end {_INTERVAL} (bootstrap), s",
    "time_high": "upper end of it, s",
    "time_over_bound": "largest share of the proven time that a start took; empty without a proof",
    "path_length": "median way of all robots together, m",
    "min_clearance": "least distance of any robot to an obstacle, m; empty without obstacles",
    "max_rise_between_merges": "largest change of V in a step up to its first merge, m²/s; "
    "negative if V fell in every step",
    "min_alignment": "least alignment |h·f|/‖f‖ of a robot with ‖f‖ ≥ 2δ",
    "contacts": "mean number of contacts in an episode, one for each robot and step",
}
"""Of results.csv: a row for each scenario and policy. Empty where it does not apply."""

PAIRED = {
    "scenario": "name of the scenario",
    "policy": "name of the policy",
    "against": "the policy that it is compared with, start by start",
    "clean_difference": "difference of the fractions of clean success, policy minus against",
    "clean_difference_low": f"lower end {_INTERVAL} (bootstrap)",
    "clean_difference_high": "upper end of it",
    "probability_of_improvement": "chance of doing better on a start: meeting cleanly, and sooner; "
    "a tie counts half",
    "improvement_low": f"lower end {_INTERVAL} (bootstrap)",
    "improvement_high": "upper end of it",
}
"""Of paired.csv: a row for each scenario and policy."""
