"""The paper's claims are graded by criteria that are named, on the runs that they are about."""

from dualhead_eval.paper.claims import grade_claims
from dualhead_eval.statistics.run import open_runs


def graded(gates):
    """Grades by the first two words of their claims."""
    return {" ".join(grade.claim.split()[:2]): grade for grade in grade_claims(open_runs(gates))}


def test_claims_without_their_runs_are_not_graded(make_gate):
    grades = list(graded([make_gate("a", partition="none")]).values())
    assert len(grades) == 9
    assert [grade.grade for grade in grades] == ["holds"] + ["not graded"] * 8
    assert "0 of 48 tables" in grades[0].evidence


def test_map_dependence_needs_seeds_or_the_population(make_gate):
    def arms(seeds, method="policy"):
        return [
            make_gate(
                f"{name} {rep} {seed}",
                couple,
                flip=flip,
                seed=seed,
                method=method,
                config={"source_noise_beta": beta, "representation": {"kinematic_map": f"ring/{rep}"}},
            )
            for seed in range(seeds)
            for rep, strength, flip in (("polar", 0.67, False), ("nullspace", 0.23, True), ("orthogonal", 0.1, True))
            for name, beta, couple in (("A", 1.0, 0.0), ("B", 0.0, strength))
        ]

    key = "The effect"
    assert graded(arms(1))[key].grade == "inconclusive"
    tested = graded(arms(6))[key]
    assert tested.grade == "holds"
    assert "permutation p" in tested.evidence
    assert graded(arms(1, method="exact reference"))[key].grade == "holds"
    same_sign = [gate for gate in arms(1) if "polar" not in gate.label]
    assert graded(same_sign)[key].grade == "does not hold"


def test_robot_claims_follow_their_criteria(make_gate):
    def robot(label, couple, valid=0.8, **config):
        return make_gate(label, couple, partition="bypass-v2", valid=valid, config=config)

    independent = robot("A", 0.0)
    latent = robot("D", 0.0, latent="prior", latent_dim=16)
    climb = robot("G", 0.5, source_noise_beta=0, consistency_weight=3, valid=0.5)
    token, weak = robot("K", 1.0, token="oracle"), robot("J", 0.5, token="window")
    grades = graded([independent, latent, climb, token])
    assert grades["Endpoint consistency"].grade == "holds"
    assert grades["Partition tokens"].grade == "holds"
    assert grades["An auxiliary"].grade in ("holds", "inconclusive")
    grades = graded([token, weak, robot("D", 0.5, latent="prior", latent_dim=16)])
    assert grades["Partition tokens"].grade == "inconclusive"
    assert grades["An auxiliary"].grade == "does not hold"
    costless = robot("G", 0.5, source_noise_beta=0, consistency_weight=3, valid=0.9)
    assert graded([independent, costless])["Endpoint consistency"].grade == "inconclusive"
