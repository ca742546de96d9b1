"""The environment for one robot after another, which refuses a wrong action as soon as it comes."""

from __future__ import annotations

from typing import Any

from pettingzoo.utils.conversions import parallel_to_aec_wrapper

from ..experiment.checks import check_action, refuse


class OneAfterAnother(parallel_to_aec_wrapper):
    """PettingZoo's AEC form of a parallel environment of ours.

    PettingZoo keeps the actions until the last robot has chosen; one that is wrong would be found
    only then, when its robot can take it back no more.
    """

    def step(self, action: Any) -> None:
        """Take the action of the robot whose turn it is; None of one that has ended.

        Raises:
            ValueError: for anything else, naming the robot; nothing has changed then.
        """
        robot = self.agent_selection
        if not (self.terminations[robot] or self.truncations[robot]):
            check_action(robot, action, self.action_space(robot).shape[0])
        elif action is not None:
            refuse(f"action of {robot}, which has ended,", action, "None")
        super().step(action)
