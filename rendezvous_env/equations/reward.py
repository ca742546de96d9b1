"""The team reward of one step (design, section 6)."""

from ..compilation import inlined_entry


@inlined_entry
def team_reward(progress, time_share, contacts, closeness, met, weights):
    """Team reward of one step.

        w₀ progress − w₁ time_share − w₂ contacts − w₄ closeness + w₃ if met

    Args:
        progress: (V_t − V_{t+1})/V_0.
        time_share: τ / time limit.
        contacts: robots in contact with an obstacle.
        closeness: Σ_i max(0, 1 − clearance_i/range), how near the robots are to obstacles.
        met: whether this step brought the rendezvous.
        weights: w = (progress, time_penalty, collision_penalty, rendezvous_bonus,
            clearance_penalty).

    Returns:
        A number without unit, like all that it is made of.
    """
    reward = weights[0] * progress - weights[1] * time_share - weights[2] * contacts
    reward = reward - weights[4] * closeness
    return reward + weights[3] if met else reward
