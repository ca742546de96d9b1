"""What the README shows is true: its code runs, its commands and scenarios exist."""

import re
from pathlib import Path

import rendezvous_env as rv
from train.cli import COMMANDS

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


def test_every_python_block_runs(capsys):
    blocks = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), names)
    assert len(blocks) == 4
    assert names["observations"].shape == (256, 4, 3 + 8 * 2, 2)
    assert names["trajectory"].success.all()
    printed = capsys.readouterr().out
    assert "'success': True" in printed
    assert "theorems 2 and C" in printed


def test_the_commands_shown_exist():
    shown = set(re.findall(r"`rendezvous (\w+)", README))
    assert shown == set(COMMANDS)


def test_the_scenarios_shown_exist():
    shown = set(re.findall(r'"((?:fig|swarm-|ring-|clutter-)\w+)"', README))
    assert shown and shown <= set(rv.scenarios.names())
    assert (Path(__file__).parent.parent / "docs/images/fig4.png").stat().st_size > 10_000
