"""Models and candidates as a search has them: what tests of its single steps begin with."""

import numpy as np

from skhyst.diagnosis import EFFECTS
from skhyst.diagnosis._candidates import Candidate, held_out, refitted, screened
from skhyst.diagnosis._contest import Contest
from skhyst.diagnosis._criterion import Criterion
from skhyst.diagnosis._edits import AddDisturbance, Insert, InsertAt
from skhyst.diagnosis._starts import Scene
from skhyst.diagnosis._tree import Tree

USUAL = Criterion(alpha=0.01, min_improvement=0.05)


def tree_of(model, operator):
    """Return the tree of a model with given parameters."""
    return Tree.of(model, operator)


def fitted(model, records):
    """Return the tree of a model that is identified from records."""
    return Tree.from_result(model, model.identify(records))


def with_stage(tree, name, model, operator):
    """Return a tree with one more stage, at the place of its kind."""
    return tree.edited(name, Insert(model, operator))


def in_front(tree, name, model, operator):
    """Return a tree with one more stage before all others."""
    return tree.edited(name, InsertAt(None, model, operator))


def with_disturbance(tree, name, model, operator):
    """Return a tree with an additive disturbance."""
    return tree.edited(name, AddDisturbance(model, operator))


def candidate(tree, records=None, folds=None, effects=(), **known):
    """Return a tree as a candidate, at its present parameters; with folds it is held out."""
    x = np.empty(0) if records is None else tree.problem(records).x0
    known = {"cost": np.inf, "n_parameters": len(x), "x": x} | known
    known = {"predicted_cost": known["cost"]} | known
    found = Candidate(tuple(effects), tree, **known)
    return found if folds is None else held_out(found, records, folds)


def entered(form, tree, records, name="effect"):
    """Return the trees in which a variant of an effect has entered a model."""
    return form.trees(name, Scene(tree, records))


def refit(found, records, folds=None, **options):
    """Return a candidate that is refitted to records; with folds it is held out."""
    found = refitted(found, found.structure, records, **options)
    return found if folds is None else held_out(found, records, folds)


def variants(name, tree, records):
    """Return the screened variants of an effect in a model."""
    return screened(EFFECTS[name], tree, records)


def contest(records, folds, *names, criterion=USUAL, judge=None, **options):
    """Return a contest of effects that says nothing about its progress."""
    usual = {"max_effects": 3, "n_jobs": 1, "negligible": 0.0, "renew": None, "judge": judge}
    usual |= {"effects": [EFFECTS[name] for name in names], "report_progress": lambda *_: None}
    return Contest(records=records, folds=folds, criterion=criterion, **usual | options)
