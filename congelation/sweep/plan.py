"""The runs of a scenario: its variants, at every point of a sweep."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import cast

from congelation.cosim.coupling import make_coupling, refuse_tolerance
from congelation.errors import InvalidInput
from congelation.fmi.description import describe
from congelation.results.identity import code_version, content_hash, file_hash
from congelation.scenario.axes import Settings
from congelation.scenario.scenario import EXPERIMENT, Case, Experiment, Scenario
from congelation.scenario.start_values import Scalar

__all__ = ["Run", "plan_run", "plan_runs", "varied_settings"]


@dataclass(frozen=True)
class Run:
    """One simulation to do; equal content has an equal `run_id`.

    `settings` has the value of every setting that any run of the plan changes, None for a start
    value left to the FMU; `seed` is that of the sweep which drew them, None outside of sweeps,
    and `replicate` the number of the repetition, None without replicates.
    """

    run_id: str
    variant: str
    settings: Mapping[str, Scalar | None]
    case: Case
    seed: int | None = None
    replicate: int | None = None


def varied_settings(scenario: Scenario, swept: Iterable[str] = ()) -> tuple[str, ...]:
    """Names of the settings that a variant changes, and of those that are swept."""
    by_variant = (name for variant in scenario.variants for name in variant.settings)
    return tuple(dict.fromkeys((*by_variant, *swept)))


def plan_runs(scenario: Scenario) -> Iterator[Run]:
    """One run per variant."""
    varied = varied_settings(scenario)
    for variant in scenario.variants:
        yield plan_run(scenario, variant.name, variant.settings, varied)


def plan_run(
    scenario: Scenario,
    variant: str,
    settings: Settings,
    varied: Sequence[str],
    seed: int | None = None,
    replicate: int | None = None,
) -> Run:
    """The run of a scenario with some settings; `varied` names those that its row shows.

    The seed of the sweep and the number of the replicate are no part of what it consists of.

    Raises
    ------
    InvalidInput
        If the experiment does not stand with these settings.
    """
    case = scenario.case(settings)
    _require_steps(scenario, case.experiment)
    content = {
        "variant": variant,
        "components": [
            [c.name, describe(c.fmu).sha256, {k: _content(v) for k, v in c.start.items()}]
            for c in case.system.components
        ],
        "connections": [str(connection) for connection in case.system.connections],
        "experiment": asdict(case.experiment),
        "metrics": [[m.name, m.metric, m.of, dict(m.options)] for m in scenario.metrics],
        "code": code_version(),
    }
    shown = {name: _setting(case, name) for name in varied}
    return Run(content_hash(content), variant, shown, case, seed, replicate)


def _require_steps(scenario: Scenario, experiment: Experiment) -> None:
    """Raise InvalidInput unless the coupling can do with a tolerance, if there is one.

    Only of a whole run: a variant may give the one, and a point of a sweep the other.
    """
    if experiment.tolerance is None:
        return
    coupling = make_coupling(experiment.coupling, experiment.options)
    try:
        refuse_tolerance(coupling, experiment.tolerance)
    except InvalidInput as error:
        raise InvalidInput(f"{scenario.file}: {EXPERIMENT}.tolerance: {error}") from error


def _content(value: object) -> object:
    """A start value as content; of a file that one names, what is in it."""
    if isinstance(value, str) and Path(value).is_file():
        return file_hash(Path(value))
    return value


def _setting(case: Case, name: str) -> Scalar | None:
    """The value of ``owner.key`` in a case; None for a start value left to the FMU."""
    owner, _, key = name.partition(".")
    if owner == EXPERIMENT:
        return cast(Scalar, getattr(case.experiment, key))
    component = next(c for c in case.system.components if c.name == owner)
    return cast(Scalar | None, component.start.get(key))  # a scenario's start values are flat
