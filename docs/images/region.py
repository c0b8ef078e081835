"""The README's attainable region: the ring's optimum under five couplings, from the committed references.

python docs/images/region.py
"""

from pathlib import Path

from dualhead_eval.gate import read_gate
from dualhead_eval.report.content import make_report
from dualhead_eval.report.figures.region import draw_region

REFERENCES = Path("results/studies/references")
SHOWN = {
    "nothing shared": "ring2-nullspace/exact_beta_1",
    "source noise, nullspace map": "ring2-nullspace/exact_beta_0",
    "source noise, orthogonal map": "ring2-orthogonal/exact_beta_0",
    "source noise, polar map": "ring2-polar/exact_beta_0",
    "oracle token, a tenth of them replaced": "ring2-nullspace/exact_oracle_replacement_0.1",
    "oracle token": "ring2-nullspace/exact_oracle_replacement_0",
}


def main() -> None:
    gates = [read_gate(REFERENCES / f"{file}-frozen.gate.json.gz") for file in SHOWN.values()]
    for name, gate in zip(SHOWN, gates, strict=True):
        gate.provenance["label"] = name
    print(draw_region(make_report(gates), Path(__file__).with_suffix(".png")))


if __name__ == "__main__":
    main()
