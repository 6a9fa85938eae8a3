"""A plant, and what an effect says about how it changes one."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from .physics import refine

SUBSTEPS = 32

Stage = Callable[[np.ndarray, float], np.ndarray]


@dataclass(frozen=True)
class Plant:
    """A signal path from drive to clean response (see the head of the package).

    Each stage is called with a signal and the time between its samples, in sampling intervals.
    """

    first: tuple[Stage, ...] = ()
    core: tuple[Stage, ...] = ()
    middle: tuple[Stage, ...] = ()
    motion: tuple[Stage, ...] = ()
    dynamics: tuple[Stage, ...] = ()
    last: tuple[Stage, ...] = ()

    def respond(self, drive, substeps=SUBSTEPS):
        """Return the response at the samples of one record's drive, without what is beside."""
        signal = refine(drive, substeps)
        path = self.first + self.core + self.middle + self.motion + self.dynamics + self.last
        for stage in path:
            signal = stage(signal, 1.0 / substeps)
        return signal[::substeps]

    def insert(self, place, stage):
        """Return the plant with one more stage at the end of a place."""
        return replace(self, **{place: (*getattr(self, place), stage)})

    def adapt(self, place, law=None, **parameters):
        """Return the plant with parameters of the one stage of a place added, or another law."""
        (stage,) = getattr(self, place)
        adapted = partial(law or stage.func, **{**stage.keywords, **parameters})
        return replace(self, **{place: (adapted,)})


@dataclass(frozen=True)
class Setting:
    """What an effect has to know of the plant that it enters; the response here peaks near one."""

    drive: tuple[float, float]  # lowest and highest drive of the records to fit on
    response: tuple[float, float]  # the same of the response without the effect
    settled: tuple[float, float]  # the same of the core alone, without a mode's overshoot
    lengths: tuple[int, ...]  # samples of each record, held-out records last
    mode: float  # frequency of the plant's own mode, in cycles a sample; 0 without one
    dt: float  # sampling interval, s
    unit: float  # response units per one
    declared: str = "prandtl_ishlinskii"
    drives: tuple = ()  # of each record
    motion: dict = field(default_factory=dict)  # parameters of the plant's own mode
    core: dict = field(default_factory=dict)  # parameters of the core
    substeps: int = SUBSTEPS


@dataclass(frozen=True)
class Effect:
    """How the plant of each record is changed, what is added to each response; its parameters.

    A stage is inserted at its place; a list of stages holds one for each record. `alter` returns
    the plant of a record, by its number, from the one before.
    """

    truth: dict
    place: str = ""
    stage: Stage | list | None = None
    alter: Callable[[Plant, int], Plant] | None = None
    beside: list = field(default_factory=list)
    column: tuple[str, list] = ("", [])

    def changes(self, plants):
        """Return the plants of all records, changed."""
        if self.alter is not None:
            return [self.alter(plant, number) for number, plant in enumerate(plants)]
        if self.stage is None:
            return plants
        stages = self.stage if isinstance(self.stage, list) else [self.stage] * len(plants)
        return [p.insert(self.place, s) for p, s in zip(plants, stages, strict=True)]
