"""Public names: vocabulary of the field, one class per name."""

import ast
import dataclasses
import inspect
import re
from collections import defaultdict
from contextlib import suppress
from importlib import import_module

import pytest
from conftest import ROOT
from test_package import MODULES, source_of

import baselines
import rendezvous_env as rv
from rendezvous_env.scenario import scenarios
from train import cli, results
from train.leaderboard import registry

FORMER_WORDS = frozenset((
    "begin_anew", "book", "card", "cards", "clean", "cleanly", "crowded", "gone", "guide", "guided",
    "joined", "late", "owes", "silhouette", "silhouettes", "sight", "sights", "starts", "survivor",
    "teams", "told", "touch", "touches", "whom", "wrong",
))  # fmt: skip
"""Words of earlier versions that public names do not use; docs/migration.md lists replacements."""
ALIASES = {"baselines.robot_sight"}
"""Modules that only provide former names."""
FIELD_NAMES = {
    "huettenrauch-20-sight-40": "versioned scenario: its digest covers the name",
}
"""Names that keep a former word, with the reason."""
SHARED = {
    "Config": "settings of a command, one per command module",
    "Robot": "named tuples that compiled kernels take; the name is part of their signatures",
    **dict.fromkeys(
        ("EnergyTankWrapper", "GainWrapper", "GuaranteeWrapper", "HeadingVectorWrapper",
         "LinkKeepingWrapper"),
        "PettingZoo form and vector form, as wrappers of Gymnasium have them",
    ),
}  # fmt: skip
"""Names of several classes, with the reason."""


def words_of(name: str) -> set[str]:
    """Words of a name in snake_case, CamelCase or kebab-case."""
    return set(re.findall(r"[a-z]+", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()))


def former_words(name: str) -> set[str]:
    return words_of(name) & FORMER_WORDS if name not in FIELD_NAMES else set()


def classes() -> dict[str, list[str]]:
    """Modules of every class by its name."""
    found = defaultdict(list)
    for module in MODULES:
        for node in ast.walk(ast.parse(source_of(module).read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                found[node.name].append(module)
    return found


def public_objects():
    """Label and object of public functions and classes."""
    for home in (rv, baselines, rv.vector, rv.graphs, import_module("rendezvous_env.jax")):
        for name in getattr(home, "__all__", dir(home)):
            yield f"{home.__name__}.{name}", getattr(home, name)


def test_words_are_found_in_names_of_any_case():
    assert words_of("TrainingTeams") == {"training", "teams"}
    assert words_of("robot_sight") == words_of("robot-sight") == {"robot", "sight"}
    assert former_words("tank-joined") == {"joined"} and not former_words("insight_team")


@pytest.mark.parametrize("kind", ["modules", "classes", "tests"])
def test_names_use_words_of_the_field(kind):
    names = {
        "modules": [m for m in MODULES if m not in ALIASES],
        "classes": list(classes()),
        "tests": [path.stem for path in (ROOT / "tests").rglob("*.py")],
    }[kind]
    assert {name: found for name in names if (found := former_words(name))} == {}


def test_registered_names_use_words_of_the_field():
    names = [*scenarios.names(), *baselines.names(), *registry.known()]
    assert {name: found for name in names if (found := former_words(name))} == {}


def test_flags_and_columns_use_words_of_the_field():
    names = [*results.RESULTS, *results.PAIRED]
    for module, _ in cli.COMMANDS.values():
        names += [one.name for one in dataclasses.fields(import_module(f"train.{module}").Config)]
    assert {name: found for name in names if (found := former_words(name))} == {}


def test_public_attributes_and_arguments_use_words_of_the_field():
    found = {}
    for label, one in public_objects():
        names = set(vars(one)) if inspect.isclass(one) else set()
        deprecated = {n for n in names if "Deprecated" in (inspect.getdoc(vars(one)[n]) or "")}
        with suppress(TypeError, ValueError):  # no function, or an exception without a signature
            names |= set(inspect.signature(one).parameters)
        names = {name for name in names - deprecated if not name.startswith("_")}
        found |= {f"{label}.{name}": former_words(name) for name in names if former_words(name)}
    assert found == {}


def test_classes_have_names_of_their_own():
    several = {name: homes for name, homes in classes().items() if len(homes) > 1}
    public = {name: homes for name, homes in several.items() if not name.startswith("_")}
    assert public.keys() - SHARED.keys() == set(), public
    assert SHARED.keys() <= public.keys()
