"""`skhyst models` and `skhyst effects`: lists of declarable models and of effects."""

from ..diagnosis import EFFECTS, effect_names
from ..discovery import declarable_models


def list_models(options):
    """Print the models that can be declared."""
    models = declarable_models()
    _print_aligned({name: model.__doc__.strip().splitlines()[0] for name, model in models.items()})


def list_effects(options):
    """Print the effects that a search tries."""
    _print_aligned({name: EFFECTS[name].law for name in effect_names()})


def _print_aligned(table):
    width = 2 + max(map(len, table))
    for name, text in table.items():
        print(f"{name:{width}s}{text}")
