"""A stepper takes the states that it could be in: none makes its law look up what is not there.

Compiled code does not check places. So the laws are run as plain Python, which does.
"""

import copy
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from operator_cases import DT, OPERATORS, make_drive

from skhyst.operators import CompiledSeries, Stepper, SumOperator, inverse_of

HOSTILE = [-1.0, 0.5, 1.0, 1e3, 1e9, 1e300, -1e300]


def steppers():
    """Yield each operator's stepper, fresh and under way, and those of what looks ahead."""
    u = make_drive()
    for name, operator in OPERATORS.items():
        if operator.causal:
            state = operator.init(u[0])
            yield name, Stepper(operator.compiled_step(DT, state))
            yield name, Stepper(operator.compiled_step(DT, operator.run(u[:30], DT, state)[1]))
    for name in ("mode", "transfer function", "tanh", "delay of several samples", "relays", "sum"):
        yield f"{name}, inverted", Stepper(inverse_of(OPERATORS[name]).ahead(DT, u[0])[0])


def faults():
    """Return what is looked up outside of a table or a state, after hostile states."""
    found, u = [], make_drive()[:6]
    for name, stepper in steppers():
        own = stepper.state
        for place in {*range(min(6, len(own))), *range(max(len(own) - 6, 0), len(own))}:
            for value in HOSTILE:
                state = own.copy()
                state[place] = value
                other = stepper.copy()
                try:
                    other.state = state
                except ValueError:
                    continue
                try:
                    for drive in u:
                        other.step(drive)
                except IndexError as error:
                    found.append(f"{name}, state {place} = {value}: {error}")
                except (ValueError, ArithmeticError) as error:  # exp and log may end in infinity
                    if "to integer" in str(error):
                        found.append(f"{name}, state {place} = {value}: {error}")
    return found


@pytest.mark.parametrize("value", [-1.0, 0.5, 1e9])
@pytest.mark.parametrize(
    ("name", "place"),
    [("delay of several samples", 0), ("time shift, ahead", 0), ("relays", -3), ("Bouc-Wen", 4)],
)
def test_places_out_of_range_are_refused(name, place, value):
    operator, u = OPERATORS[name], make_drive()
    if operator.causal:
        state = operator.run(u[:30], DT, operator.init(u[0]))[1]
        stepper = Stepper(operator.compiled_step(DT, state))
        stepper.run(u[30:60])
    else:
        stepper = Stepper(operator.ahead(DT, u[0])[0])
    state = stepper.state
    stepper.state = state
    state[place] = value
    with pytest.raises(ValueError, match="as it was read"):
        stepper.state = state
    whole = Stepper(CompiledSeries((stepper.compiled_step, stepper.compiled_step)))
    with pytest.raises(ValueError, match="as it was read"):
        whole.state = np.append(stepper.state, state)


@pytest.mark.parametrize("more", [(), ("slip elements",)])
def test_a_root_takes_the_states_of_its_law(more):
    """Compiled as one step, and of several parts."""
    relays, *others = (OPERATORS[name] for name in ("relays", *more))
    operator = SumOperator(("own", *more), (relays, *others)) if more else relays
    y, _ = operator.run(make_drive(), DT)
    stepper = Stepper(inverse_of(operator).ahead(DT, y[0])[0])
    stepper.run(y[:30])
    state = stepper.state
    stepper.state = state
    behind = [own.compiled_step(DT, own.init(0.0)).state for own in others]
    state[-3 - sum(map(len, behind))] = 1e9  # the number of corners
    with pytest.raises(ValueError, match="as it was read"):
        stepper.state = state


@pytest.mark.parametrize("name", ["plays", "slip elements"])
@pytest.mark.parametrize("copied", [Stepper.copy, copy.copy, copy.deepcopy])
def test_a_copy_goes_its_own_way(name, copied):
    stepper = Stepper(OPERATORS[name].compiled_step(DT, OPERATORS[name].init(0.0)))
    stepper.run(make_drive()[:30])
    state = stepper.state
    other = copied(stepper)
    other.step(3.0)
    np.testing.assert_array_equal(stepper.state, state)
    assert (other.state != state).any()
    again = stepper.copy()
    again.step(3.0)
    np.testing.assert_array_equal(other.state, again.state)
    kept = pickle.loads(pickle.dumps(other))
    assert (kept.output, kept.status, kept.dt) == (other.output, other.status, other.dt)
    np.testing.assert_array_equal(kept.run(make_drive()), other.run(make_drive()))


@pytest.mark.slow
def test_no_state_that_is_taken_leads_out_of_a_table():
    script = "import json, test_states; print(json.dumps(test_states.faults()))"
    here = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    plain = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": here}
    done = subprocess.run([sys.executable, "-c", script], env=plain, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == []
