import numpy as np

from skhyst.autoregressive._tree_loops import NODE, trees_rows, trees_run


def stump(threshold, below, above, feature, root=0):
    nodes = np.zeros(3, dtype=NODE)
    nodes[0] = threshold, feature, root + 2
    nodes[1] = below, -1, 0
    nodes[2] = above, -1, 0
    return nodes


NODES = np.concatenate([stump(0.5, 1.0, 2.0, 0), stump(0.0, 10.0, 20.0, 1, root=3)])
ROOTS = np.array([0, 3])
NO_SCALE = np.zeros(2), np.ones(2)


def test_rows_sum_the_trees():
    Z = np.array([[0.5, 0.0], [0.6, 0.0], [0.5, 0.1], [9.0, 9.0]])
    for rows in (trees_rows, trees_rows.py_func):
        out = np.empty(4)
        rows(NODES, ROOTS, *NO_SCALE, False, Z, out)
        np.testing.assert_array_equal(out, [11.0, 12.0, 21.0, 22.0])


def test_features_are_scaled_and_rounded_before_they_are_compared():
    Z = np.array([[0.5 + 1e-12, 0.0]])
    out = np.empty(1)
    trees_rows(NODES, ROOTS, *NO_SCALE, False, Z, out)
    assert out == 12.0
    trees_rows(NODES, ROOTS, *NO_SCALE, True, Z, out)
    assert out == 11.0
    trees_rows(NODES, ROOTS, np.array([1.0, 0.0]), np.array([-1.0, 1.0]), True, Z, out)
    assert out == 11.0
    trees_rows(NODES, ROOTS, np.array([1.0, 0.0]), np.array([-0.5, 1.0]), True, Z, out)
    assert out == 12.0


def test_run_sees_its_own_output():
    inputs = np.array([[0.0], [1.0], [0.0], [0.0]])
    for run in (trees_run, trees_run.py_func):
        y = np.array([-1.0, 0, 0, 0, 0])
        n_good = run(NODES, ROOTS, *NO_SCALE, True, -21.5, 1.0, inputs, np.array([1]), 9.0, y)
        # 1 + 10 below; 2 + 10 below; 1 + 10, always below zero, and cut off where beyond 9
        np.testing.assert_array_equal(y, [-1.0, -9.0, -9.0, -9.0, -9.0])
        assert n_good == 0
        y = np.array([-1.0, 0, 0, 0, 0])
        run(NODES, ROOTS, *NO_SCALE, True, -11.5, 1.0, inputs, np.array([1]), 99.0, y)
        np.testing.assert_array_equal(y, [-1.0, -0.5, 0.5, 9.5, 9.5])
