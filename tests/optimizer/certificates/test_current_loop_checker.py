"""The checker refuses everything that makes its statement false, however it is planted."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from random_current_loops import limit, random_boxes, times

import dqforge.optimizer.certificates.cell_queue as finder
from dqforge.optimizer.certificates.cell_queue import (
    CurrentLoopBox,
    find_certificate,
    loop_matrices,
)
from dqforge.optimizer.certificates.current_loop_proof import (
    confirm,
    plain_certificate,
    plain_inputs,
)

Certificate = dict[str, Any]


def certificate_of(box: CurrentLoopBox) -> Certificate:
    found = find_certificate(box)
    assert found.complete
    plain: Certificate = json.loads(json.dumps(plain_certificate(box, found.tree)))
    return plain


@cache
def certified() -> list[tuple[CurrentLoopBox, Certificate]]:
    """Certificates with two cells or more, of loops 3 % below their limit."""
    found: list[tuple[CurrentLoopBox, Certificate]] = []
    for box in random_boxes(30, 5, fast=True):
        most = None if len(found) == 3 else limit(box)
        if most is not None:
            near = times(box, 0.97 * most)
            found.append((near, certificate_of(near)))
    assert min(len(certificate["tree"]) for _, certificate in found) > 2
    return found


def proven(certificate: Certificate, box: CurrentLoopBox) -> bool:
    return confirm(certificate, json.loads(json.dumps(plain_inputs(box)))).proven


def leaves(certificate: Certificate) -> list[int]:
    return [k for k, verdict in enumerate(certificate["tree"]) if len(verdict) == 21]


def test_good_certificates_are_confirmed() -> None:
    assert len(certified()) == 3
    assert all(proven(certificate, box) for box, certificate in certified())


def exchanged(tree: list[Any], cells: list[int]) -> None:
    tree[cells[0]], tree[cells[-1]] = tree[cells[-1]], tree[cells[0]]


def half_empty(tree: list[Any], cells: list[int]) -> None:
    for cell in cells[: (len(cells) + 1) // 2]:
        tree[cell] = "empty"


def half_open(tree: list[Any], cells: list[int]) -> None:
    for cell in cells[: (len(cells) + 1) // 2]:
        tree[cell] = "open"


def cut_outside(tree: list[Any], _: list[int]) -> None:
    tree[0][1] *= 10.0


def cut_below(tree: list[Any], _: list[int]) -> None:
    tree[0][1] = -1.0


def unknown_parameter(tree: list[Any], _: list[int]) -> None:
    tree[0][0] = 4


def one_for_all(tree: list[Any], cells: list[int]) -> None:
    tree[:] = [tree[cells[0]]]


def one_copied(tree: list[Any], cells: list[int]) -> None:
    for cell in cells:
        tree[cell] = tree[cells[0]]


def one_missing(tree: list[Any], cells: list[int]) -> None:
    del tree[cells[-1]]


def one_more(tree: list[Any], cells: list[int]) -> None:
    tree.append(tree[cells[0]])


def negative(tree: list[Any], cells: list[int]) -> None:
    tree[cells[0]] = [-entry for entry in tree[cells[0]]]


def unit(tree: list[Any], cells: list[int]) -> None:
    tree[cells[0]] = np.eye(6)[np.triu_indices(6)].tolist()


def weak(tree: list[Any], cells: list[int]) -> None:
    """Its least eigenvalue over 1000: no longer falls along the loop."""
    matrix = np.zeros((6, 6))
    matrix[np.triu_indices(6)] = tree[cells[0]]
    matrix = matrix + np.triu(matrix, 1).T
    values, vectors = np.linalg.eigh(matrix)
    values[-1] /= 1000.0
    tree[cells[0]] = (vectors * values @ vectors.T)[np.triu_indices(6)].tolist()


def not_a_number(tree: list[Any], cells: list[int]) -> None:
    tree[cells[0]][3] = float("nan")


def words(tree: list[Any], cells: list[int]) -> None:
    tree[cells[0]] = ["1.0"] * 21


def without_symmetry(tree: list[Any], cells: list[int]) -> None:
    """All 36 entries, as a matrix that is not symmetric would need."""
    tree[cells[0]] = [*tree[cells[0]], *tree[cells[0]][:15]]


FORGERIES = [
    exchanged, half_empty, half_open, cut_outside, cut_below, unknown_parameter, one_for_all,
    one_copied, one_missing, one_more, negative, unit, weak, not_a_number, words, without_symmetry,
]  # fmt: skip


@pytest.mark.parametrize("forge", FORGERIES, ids=lambda forge: forge.__name__)
def test_forged_trees_are_refused(forge: Callable[[list[Any], list[int]], None]) -> None:
    for box, certificate in certified():
        forged = copy.deepcopy(certificate)
        forge(forged["tree"], leaves(forged))
        assert not proven(forged, box)


def wider(box: CurrentLoopBox) -> Certificate:
    inputs = plain_inputs(box)
    for name in ("l_d", "l_q"):
        low, high = inputs[name]
        inputs[name] = [low / 0.7 * 0.5, high / 1.3 * 1.5]
    return inputs


CHANGES: dict[str, Callable[[CurrentLoopBox], Certificate]] = {
    "inductances": wider,
    "dc link": lambda box: plain_inputs(box) | {"gain": [0.6, 1.6]},
    "speed": lambda box: plain_inputs(box) | {"omega_e": 2.0 * box.omega_e},
    "kp": lambda box: plain_inputs(box) | {"kp": [1.5 * kp for kp in box.kp]},
    "t_s": lambda box: plain_inputs(box) | {"t_s": 1.3 * box.t_s},
    "gains beyond the limit": lambda box: plain_inputs(times(box, 1.04)),
}


@pytest.mark.parametrize("change", CHANGES)
def test_certificates_of_other_drives_are_refused(change: str) -> None:
    """By comparison, and where the inputs are forged as well by the matrices themselves."""
    for box, certificate in certified():
        inputs = CHANGES[change](box)
        assert "another" in confirm(certificate, inputs).fault
        assert not confirm(certificate | {"inputs": inputs}, inputs).proven


def test_inputs_are_compared_to_the_bit() -> None:
    box, certificate = certified()[0]
    inputs = plain_inputs(box)
    inputs["kp"] = [np.nextafter(box.kp[0], 0.0), box.kp[1]]
    assert "another kp" in confirm(certificate, inputs).fault
    del inputs["kp"]
    assert confirm(certificate, inputs).fault
    assert confirm({"tree": certificate["tree"]}, plain_inputs(box)).fault


def no_delay(matrices: np.ndarray) -> np.ndarray:
    """The voltage of a sample acts at once: phi+ = (Phi + Gam K) phi + Gam I."""
    changed = matrices.copy()
    gam = matrices[:, :2, 2:4]
    changed[:, :2] = 0.0
    changed[:, :2, :2] = matrices[:, :2, :2] + gam @ matrices[:, 2:4, :2]
    changed[:, :2, 4:] = gam
    return changed


def other_decoupling(matrices: np.ndarray) -> np.ndarray:
    """The sign in the decoupling that lets the finder's loop be another."""
    changed = matrices.copy()
    changed[:, 2, 1] *= -1.0
    changed[:, 3, 0] *= -1.0
    return changed


def no_decoupling(matrices: np.ndarray) -> np.ndarray:
    changed = matrices.copy()
    changed[:, 2, 1] = changed[:, 3, 0] = 0.0
    return changed


@pytest.mark.parametrize("fault", [no_delay, no_decoupling, other_decoupling])
def test_a_finder_with_another_model_convinces_nobody(
    fault: Callable[[np.ndarray], np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond the limit and near it nothing passes; with half the gains the statement is true and a
    matrix of another model may happen to prove it.
    """
    boxes = [near for near, _ in certified()]
    monkeypatch.setattr(finder, "loop_matrices", lambda box, at: fault(loop_matrices(box, at)))
    refused = 0
    for near in boxes:
        for factor in (1.01 / 0.97, 1.0, 0.5):
            box = times(near, factor)
            found = find_certificate(box, 150)
            if found.complete:
                accepted = proven(plain_certificate(box, found.tree), box)
                assert not accepted or factor == 0.5
                refused += not accepted
    assert refused >= 1


def test_a_box_that_holds_no_drives_is_refused() -> None:
    box, certificate = certified()[0]
    for name, value in (("gain", [0.0, 1.2]), ("l_d", [1e-3, 1e-4]), ("r_s", [-1.0, 1.0])):
        inputs = plain_inputs(box) | {name: value}
        assert not confirm(certificate | {"inputs": inputs}, inputs).proven
