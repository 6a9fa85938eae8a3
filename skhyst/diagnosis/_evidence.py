"""What a claim rests on: a sentence, numbers with their errors, and a picture."""

from ..fluid import TankChainOperator
from ._evidence_base import Claim, Evidence, Picture
from ._evidence_curves import CURVES, describe_stage, describe_tanks
from ._evidence_forces import FORCES
from ._evidence_records import (
    BESIDE,
    describe_beside,
    describe_branch,
    describe_modulation,
    describe_schedule,
)
from ._evidence_series import DYNAMICS, describe_moved_modes

__all__ = ["Evidence", "Picture", "gather_evidence"]

_OF_STAGES = DYNAMICS | CURVES | FORCES


def gather_evidence(effect, structure, result, records, before, after, columns=()):
    """Return the evidence for a claimed effect.

    Parameters
    ----------
    effect : Effect
    structure : Tree
        The augmented model at its solution.
    result : IdentificationResult
        Of the augmented model, fitted on all records.
    records : sequence of RecordData
    before, after : Contestant
        Held-out residuals of the declared and of the augmented model.
    columns : sequence of str, default=()
        Names of the columns of X.

    Returns
    -------
    Evidence
    """
    claim = Claim(effect.name, structure, result, tuple(records), before, after, tuple(columns))
    share = 100.0 * (1.0 - (after.error / before.error) ** 2) if before.error > 0.0 else 0.0
    statement, numbers, picture = _describer(claim)(claim)
    statement = (
        f"{statement} The augmented model removes {share:.1f} % of the power of the declared "
        "model's held-out residual."
    )
    return Evidence(effect.name, statement, numbers, picture)


def _describer(claim):
    """Return what describes a claim, by the way in which the effect entered."""
    name, structure = claim.name, claim.structure
    kind, *more = (edit.kind for edit in structure.edits_of(name))
    if kind == "beside":
        return BESIDE.get(name, describe_beside)
    if kind == "branch":
        return describe_branch
    if kind == "modulation":
        return describe_modulation
    if kind == "schedule":
        return describe_schedule
    if more:
        return describe_moved_modes
    if kind == "exchange" and isinstance(claim.operator, TankChainOperator):
        return describe_tanks
    return _OF_STAGES.get(name, describe_stage)
