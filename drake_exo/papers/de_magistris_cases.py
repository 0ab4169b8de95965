"""The paper's five cases (its Table 1) and what it found (Table 2)."""

from dataclasses import replace

from drake_exo.soles.case import (
    STAGES,
    Brick,
    Case,
    ContactBlock,
    CostBlock,
    LoadBlock,
    MaterialBlock,
    MeshBlock,
    OptimizeBlock,
    Stage,
    StartBlock,
)

SIZE = (0.23, 0.13, 0.03)
AUTHORS_STEP = "soft_sole_hrp4/trajectory/one_foot_80kg_200Hz.txt"
# Sole's centre in that file's frame: see tests/cases/hrp4_neoprene.yaml.
AUTHORS_ORIGIN = (1.274728354176543, -0.056000000000611)

# The paper's Table 2: c_tr and c_rot, initial and optimised.
TABLE_2 = {
    "1-Ref": (3.88e6, 8.06e5, 1.79e5, 1.74e5),
    "2-Rot": (3.88e6, 4.65e6, 1.79e5, 3.50e5),
    "3-Rubber": (5.39e6, 9.59e5, 2.48e5, 2.14e5),
    "4-Straight": (9.14e6, 1.02e6, 3.41e5, 5.84e4),
    "5-Fixed": (3.88e6, 1.21e6, 1.79e5, 1.16e5),
}

COARSE = (
    Stage((10, 6, 3), 24, 3e-4, 0.2, 16),
    Stage((10, 6, 3), 24, 1e-4, 0.2, 8),
)


def five_cases(load: LoadBlock, coarse: bool) -> list[Case]:
    """Table 1 of the paper with the given load.

    Args:
        load: The step.
        coarse: Two coarse stages, for a first look.
    """
    stages = COARSE if coarse else STAGES
    # Where a search ends depends on how it begins: of 3 and 5 the better.
    far = (replace(stages[0], roughness=3.0), *stages[1:])
    reference = Case(
        "1-Ref",
        MeshBlock(brick=Brick(SIZE, stages[-1].divisions)),
        MaterialBlock("neoprene"),
        load,
        ContactBlock(friction=0.8),
        StartBlock((-0.115, 0.0, -0.03), (-0.115, 0.0)),
        CostBlock(),
        OptimizeBlock(stages=stages),
    )
    farther = replace(reference, optimize=OptimizeBlock(stages=far))
    return [
        farther,
        replace(farther, name="2-Rot", cost=CostBlock(weight=1000.0)),
        replace(reference, name="3-Rubber", material=MaterialBlock("butyl")),
        replace(
            reference, name="4-Straight", load=replace(load, straight=True)
        ),
        replace(
            reference,
            name="5-Fixed",
            # Less: bends at the fixed rim count as well.
            optimize=replace(reference.optimize, fixed_top=True, roughness=3.0),
        ),
    ]
