"""Bad gate files: damaged, edited with a checksum that is right again, and inconsistent."""

from __future__ import annotations

import hashlib
import json
import lzma
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from cases import Case, Products, file_case, report
from damage import CONTROL, Damage, byte_damages, doubled, json_damages

from dualhead_eval.gate import read_gate, write_gate
from dualhead_eval.gate.pack import write_pack


def gate_cases(products: Products) -> Iterator[Case]:
    rng = np.random.default_rng(1)
    whole = products.gate
    for what, damage in byte_damages(whole.stat().st_size, rng):
        yield file_case(f"gate: {what}", whole, damage, report)
    yield file_case("gate: a field given twice", whole, doubled, report)
    small = whole.with_name("small.gate.json.gz")
    if not small.exists():
        write_gate(read_gate(whole), small)
    for what, damage in byte_damages(small.stat().st_size, rng):
        yield file_case(f"compressed gate: {what}", small, damage, report)
    pack = whole.with_name("small.gates.jsonl.xz")
    if not pack.exists():
        write_pack(pack, {"one": read_gate(whole), "two": read_gate(whole)})
    for what, damage in byte_damages(pack.stat().st_size, rng):
        yield file_case(f"pack of gates: {what}", pack, damage, report)
    for what, change in FOREIGN_PACKS.items():
        yield file_case(f"pack of gates: {what}", pack, _repacked(change), report)
    content = json.loads(whole.read_text())["content"]
    for what, change in json_damages(content, rng, free=("provenance",), most=90):
        if what.startswith("no strata."):
            continue  # a component may be left out
        yield file_case(f"gate, resealed: {what}", whole, _resealed(change), report)
    for what, change in INCONSISTENT.items():
        yield file_case(f"gate, resealed: {what}", whole, _resealed(change), report)


def _resealed(change: Callable[[Any], None]) -> Damage:
    """Edit a gate's content and give it the checksum that is then right."""

    def apply(path: Path) -> None:
        content = json.loads(path.read_text())["content"]
        change(content)
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
        digest = hashlib.sha256(canonical.encode()).hexdigest()
        path.write_text(json.dumps({"format": "dualhead-gate/1", "sha256": digest, "content": content}))

    return apply


def _repacked(change: Callable[[list[str]], list[str]]) -> Damage:
    """Edit the lines of a pack."""

    def apply(path: Path) -> None:
        lines = change(lzma.decompress(path.read_bytes()).decode().splitlines())
        path.write_bytes(lzma.compress("\n".join(lines).encode()))

    return apply


FOREIGN_PACKS: dict[str, Callable[[list[str]], list[str]]] = {
    "no line": lambda lines: [],
    "no names": lambda lines: lines[1:],
    "a gate too few": lambda lines: lines[:-1],
    "a gate too many": lambda lines: [*lines, lines[-1]],
    "one name twice": lambda lines: [lines[0].replace("two", "one"), *lines[1:]],
    "a name that leads out": lambda lines: [lines[0].replace("two", "../two"), *lines[1:]],
    "a name that clears the screen": lambda lines: [lines[0].replace("two", "\\u001b[2J"), *lines[1:]],
    "names that are numbers": lambda lines: ['{"format": "dualhead-gates/1", "names": [1, 2]}', *lines[1:]],
    "another version": lambda lines: [lines[0].replace("gates/1", "gates/9"), *lines[1:]],
    "a header that is a list": lambda lines: ["[]", *lines[1:]],
    "a gate that is a list": lambda lines: [*lines[:-1], "[]"],
    "a gate that is no JSON": lambda lines: [*lines[:-1], lines[-1][:-9]],
    "a gate of another count": lambda lines: [*lines[:-1], lines[-1].replace('"n_modes":2', '"n_modes":3')],
}


def _move(array: str, start: int, by: int) -> Callable[[Any], None]:
    def change(content: Any) -> None:
        values = content[array]["values"]
        largest = int(np.argmax(values))
        values[largest] -= by
        values[largest - 1 + 2 * (largest == 0)] += by

    return change


INCONSISTENT: dict[str, Callable[[Any], Any]] = {
    "a pair in another cell": _move("counts", 0, 1),
    "a pair too many": lambda content: content["counts"]["values"].__setitem__(0, content["counts"]["values"][0] + 1),
    "another number of pairs": lambda content: content["provenance"].update(pairs_per_condition=7),
    "a partition of three modes": lambda content: content["provenance"]["partition"].update(n_modes=3),
    "a partition of another tau": lambda content: content["provenance"]["partition"].update(tau=0.123),
    "a label that clears the screen": lambda content: content["provenance"].update(label=CONTROL),
    "a label of two lines": lambda content: content["provenance"].update(label="one\ntwo"),
    "a label without end": lambda content: content["provenance"].update(label="x" * 10_000),
    "the same heads": lambda content: content.update(heads=["joint", "joint"]),
    "decreasing thresholds": lambda content: content.update(taus=[0.55, 0.4]),
    "no threshold": lambda content: content.update(taus=[]),
    "another reference": lambda content: content.update(reference_tau=0.7),
    "probabilities beyond one": lambda content: content.update(target_probabilities=[0.9, 0.9]),
    "probabilities of three modes": lambda content: content.update(target_probabilities=[0.4, 0.3, 0.3]),
    "a condition given twice": lambda content: (
        content["pair_ids"].update(values=[0] * len(content["pair_ids"]["values"])),
        content["conditions"].update(values=[0.5] * len(content["conditions"]["values"])),
    ),
    "a shape beyond reason": lambda content: content["counts"].update(shape=[10**9, 10**9]),
    "a negative sum": lambda content: content["strata"]["position"]["total"]["values"].__setitem__(0, -5.0),
    "a median of nothing": lambda content: content["strata"]["position"]["median"]["values"].__setitem__(0, None),
    "a U beyond the pairs": lambda content: content["strata"]["position"]["u"]["values"].__setitem__(0, 1e12),
}
