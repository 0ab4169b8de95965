"""The subject's model, fitted to a standing trial."""

from collections import defaultdict
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from drake_exo.errors import InputError
from drake_exo.files.tables import MarkerData, between
from drake_exo.measurement.filters import fill_gaps
from drake_exo.measurement.kinematics import (
    MarkerModel,
    ankle_paths,
    build_marker_model,
    coordinates,
    residual_rms,
    residuals,
    solve_poses,
)
from drake_exo.measurement.recording import (
    check_loaded,
    read_feet,
    read_markers,
)
from drake_exo.measurement.sagittal import Axes, PlanarWrench, merge_plates
from drake_exo.measurement.settings import (
    JointCentres,
    Markers,
    RecordingSettings,
    SegmentMarkers,
    SidedMarkers,
    Standing,
    listed,
)
from drake_exo.model.assembly import SIDES, Assembly, Person
from drake_exo.model.description import (
    NOMINAL_MASS_KG,
    ball_m,
    fit_exoskeleton,
    nominal_exoskeleton,
    nominal_human,
)
from drake_exo.model.device_file import with_text
from drake_exo.model.osim_person import OsimPerson, read_person
from drake_exo.model.plant import Model
from drake_exo.model.segments import (
    ANKLE,
    CONTACT_RADIUS_M,
    CUFFED,
    LEG_JOINTS,
    SEGMENTS,
    HumanOverrides,
    HumanParameters,
    SegmentParameters,
    scale_human,
    with_overrides,
)

_LEAST_MASS_KG = 20.0  # lightest body assumed where no mass is stated


@dataclass(frozen=True)
class SubjectModel:
    """The subject's model and marker set, fitted to the standing trial.

    Attributes:
        model: planar model of the subject, with the device if one is worn.
        markers: segments, joint centres and marker positions on the segments.
        mass_kg: body mass without the exoskeleton.
        report: values found and their origin, for the quality report.
    """

    model: Model
    markers: MarkerModel
    mass_kg: float
    report: dict[str, Any]


def fit_subject(settings: RecordingSettings, root: Path) -> SubjectModel:
    """Scale the model to the subject and the standing trial.

    Raises:
        InputError: unreadable or unsuitable standing trial, unknown body
            mass, or a sphere or cuff whose position is not defined.
    """
    if isinstance(settings.model, Assembly):
        settings = replace(settings, model=with_text(settings.model, root))
    laboratory = settings.laboratory.facing(settings.standing.marker_axes)
    settings = replace(settings, laboratory=laboratory)
    axes = laboratory.marker_axes
    person, who = None, settings.assembly.human
    if who.osim is not None:
        height, sex = settings.subject.height_m, settings.subject.sex
        person = read_person(root / who.osim, who, height, sex)
    recorded = read_markers(settings.standing.markers, settings, root)
    named, upright = settings.markers, None
    if named is None:
        named, upright = model_markers(person, who, recorded)
    filled, gaps = fill_gaps(
        recorded,
        [n for n in _all_names(named) if n in recorded.names or not upright],
        settings.laboratory.fill_gaps_s,
    )
    standing = _quiet_part(filled, settings.standing)
    part = standing.time[0], standing.time[-1]
    gaps.check(*part)
    device = settings.assembly.device
    welds = device.welds.values() if device else ()
    feet = [weld.to for weld in welds if weld.to.startswith("foot")]
    ball = _ball(settings, named, standing, axes, person)
    places = (standing, named, axes)
    if upright is not None:
        places = (upright, named, Axes())
    markers = build_marker_model(*places, ball, feet)
    if who.sides and markers.sides != SIDES:
        raise InputError(
            f"{standing.source}: the model has two legs, but only the "
            f"{markers.sides[0]} one has all its markers; complete "
            "markers.joint_centres and markers.segments of the other"
        )
    points = axes.points(standing.of(markers.names)).mean(axis=0)[None]
    poses = solve_poses(markers, points, standing.source)
    ankles = ankle_paths(markers, poses)
    if upright is not None:
        height = float(np.mean([p[:, 1] for p in ankles.values()]))
        markers = replace(markers, ankle_height_m=height)
    wrench = _standing_wrench(settings, root, ankles)
    subject = settings.subject
    table = scale_human(NOMINAL_MASS_KG, subject.height_m, subject.sex)
    report: dict[str, Any] = {
        "stated_mass_kg": settings.subject.mass_kg,
        "standing_residual_rms_m": residual_rms(residuals(markers, poses)),
        "standing_gaps_filled": gaps.frames(*part),
        "ankle_height_m": markers.ankle_height_m,
        "lengths_m": dict(markers.lengths_m),
        "table_leg_m": table.ankle_height_m
        + table.shank.length_m
        + table.thigh.length_m,
    }
    if settings.assembly.device is not None:
        report["device_notes"] = settings.assembly.device.notes
    if person is not None:
        report["osim"] = {
            "file": who.osim.as_posix(),
            "mass_kg": person.osim.mass_kg,
            "notes": person.notes,
            "not_seen": sorted(set(person.markers) - set(markers.names))
            if upright
            else [],
        }
    mass = _body_mass(settings, wrench, report, person)
    if person is not None or settings.scaling.lengths == "markers":
        _check_height(standing.source, markers.ankle_height_m)
    human = (
        _scaled(settings, mass, markers)
        if person is None
        else _as_modelled(person.human, mass, markers, poses)
    )
    human = with_overrides(human, settings.subject.segments, "subject.segments")
    _check_centres(settings.subject.segments, human)
    model = _with_device(settings, human)
    if settings.device is not None:
        settings.device.check(model.coordinates)
    _ = model.spheres, model.cuffs  # raises if one has no position
    q = coordinates(model, markers, poses)
    report["standing_angles_deg"] = np.rad2deg(q[0, 2:])
    if settings.scaling.trunk_com == "standing":
        human = _over_the_cop(settings, model, q, wrench, report)
        model = _with_device(settings, human)
    if wrench is not None:
        com = model.rigid.tree.center_of_mass(q)[0, 0]
        report["standing_cop_x_m"] = float(wrench.cop_x[0])
        report["standing_com_x_m"] = float(com)
    if model.has_device and not model.assembly.is_fitted:
        notes = (_device_note(model), *report["device_notes"])
        report["device_notes"] = notes
    return SubjectModel(model, markers, mass, report)


def _device_note(model: Model) -> str:
    """What a user's own device was read as, as far as one number tells."""
    bare = replace(model.assembly, device=None, cuffs={})
    trees = model.tree, replace(model, kind=bare).tree
    masses = [tree.mass for tree in trees]
    mass = masses[0] - masses[1]
    moments = [
        tree.mass * tree.center_of_mass(np.zeros((1, tree.num_positions)))[0]
        for tree in trees
    ]
    said = f"device: {model.assembly.device.name}, {mass:.4g} kg"
    if not mass > 1e-9 * masses[1]:
        return said
    hip = next(n for n in model.coordinates.human if n.startswith("hip"))
    x, z = np.subtract(*moments) / mass - model.tree.hinge_place(hip)
    return (
        f"{said}, its centre of mass {abs(x):.2f} m "
        f"{'in front of' if x > 0.0 else 'behind'} and {abs(z):.2f} m "
        f"{'above' if z > 0.0 else 'below'} the hips while both stand upright"
    )


def model_markers(
    person: OsimPerson, who: Person, seen: MarkerData
) -> tuple[Markers, MarkerData]:
    """Marker set of an OpenSim model, in the form in which a study lists it.

    Args:
        person: the OpenSim model's person, with its markers.
        who: settings of the person: number of legs, rigid or hinged toes.
        seen: a recording; markers that it lacks are left out.

    Returns:
        Marker names by segment; and one frame of all markers and joint
        centres, with all coordinates at zero, in OpenSim's x and y.
    """
    centres, places = {}, {}
    for side, own in person.places.items():
        for joint in LEG_JOINTS:
            name = f"{joint} of {person.osim.source}, {side}"
            centres[joint, side], places[name] = (name,), own[joint]
    lists = defaultdict(lambda: defaultdict(list))
    for name, (segment, side, place) in person.markers.items():
        if name not in seen.names:
            continue
        if segment == "toes" and who.toes == "rigid":
            continue  # real toes bend; these markers would turn the foot
        places[name] = place
        lists[segment][side or "middle"].append(name)
    sided = {
        segment: SidedMarkers(**{k: tuple(v) for k, v in names.items()})
        for segment, names in lists.items()
    }
    missing = [s for s in ("pelvis", *who.parts) if s not in sided]
    if missing:
        raise InputError(
            f"{seen.source}: has no marker that {person.osim.source} has on "
            f"the {missing[0]}; list markers in the study"
        )
    joints = {
        joint: SidedMarkers(**{side: centres[joint, side] for side in SIDES})
        for joint in LEG_JOINTS
    }
    p = np.array([[z.real, z.imag, 0.0] for z in places.values()])
    upright = MarkerData(
        np.zeros(1), tuple(places), p[None], seen.rate_hz, person.osim.source
    )
    return Markers(JointCentres(**joints), SegmentMarkers(**sided)), upright


def _ball(
    settings: RecordingSettings,
    markers: Markers,
    standing: MarkerData,
    axes: Axes,
    person: OsimPerson | None,
) -> tuple[float, float] | None:
    """Toe hinge (x, z) from the ankle, foot flat [m]; None for rigid toes."""
    if settings.assembly.human.toes == "rigid":
        return None
    if person is not None:
        return person.human.ball_m
    subject = settings.subject
    human = scale_human(NOMINAL_MASS_KG, subject.height_m, subject.sex)
    human = with_overrides(human, subject.segments, "subject.segments")
    centres = markers.joint_centres.ankle
    names = (*centres.left, *centres.right)
    ankle = axes.points(standing.of(names))[..., 1].mean()
    return ball_m(human)[0], CONTACT_RADIUS_M - float(ankle)


def _all_names(markers: Markers) -> list[str]:
    """Names of all markers that the study lists, with repetitions."""
    groups = [
        getattr(part, f.name)
        for part in (markers.joint_centres, markers.segments)
        for f in fields(part)
    ]
    return [n for g in groups for n in (*g.left, *g.right, *g.middle)]


def _quiet_part(data: MarkerData, standing: Standing) -> MarkerData:
    inside = _inside(data.time, standing)
    if not inside.any():
        raise InputError(
            f"{data.source}: holds no frame between standing.start_s and "
            f"end_s; it runs from {data.time[0]:g} to {data.time[-1]:g} s"
        )
    return replace(
        data, time=data.time[inside], positions=data.positions[inside]
    )


def _inside(time: np.ndarray, standing: Standing) -> np.ndarray:
    start = -np.inf if standing.start_s is None else standing.start_s
    end = np.inf if standing.end_s is None else standing.end_s
    return between(time, start, end)


def _standing_wrench(settings, root, ankles) -> PlanarWrench | None:
    """Mean wrench of both feet in standing (N = 1), see `merge_plates`."""
    standing = settings.standing
    if standing.forces is None:
        return None
    forces = read_feet(standing, settings.laboratory, settings.filter, root)
    inside = _inside(forces.time, standing)
    if not inside.any():
        raise InputError(
            f"{forces.source}: holds no sample between standing.start_s and "
            "end_s; correct them"
        )
    means = {
        foot: PlanarWrench.of(w.array[inside].mean(axis=0, keepdims=True))
        for foot, w in forces.feet.items()
    }
    return merge_plates(means, ankles)[0]


def _body_mass(
    settings: RecordingSettings, wrench, report, person: OsimPerson | None
) -> float:
    device = 0.0
    if settings.assembly.is_fitted:
        device = with_overrides(
            nominal_exoskeleton(), settings.exoskeleton, "exoskeleton"
        ).mass_kg
    elif settings.assembly.device is not None:
        alone = replace(settings.assembly, device=None, cuffs={})
        device = (
            Model(settings.assembly, nominal_human()).tree.mass
            - Model(alone, nominal_human()).tree.mass
        )
    measured = None
    if wrench is not None:
        measured = float(wrench.force[0, 1]) / settings.gravity_m_s2 - device
        report["standing_mass_kg"] = measured
    stated, source = settings.subject.mass_kg, "study"
    if stated is None and person is not None:
        stated, source = person.osim.mass_kg, "OpenSim model"
        report["stated_mass_kg"] = stated
    if stated is None and measured is None:
        raise InputError(
            f"{settings.standing.markers}: the body mass is unknown; give "
            "subject.mass_kg, or standing.forces of quiet standing"
        )
    if wrench is not None:
        usual = (stated or _LEAST_MASS_KG) * settings.gravity_m_s2
        check_loaded(
            listed(settings.standing.forces), wrench, usual, "in standing"
        )
    report["mass_from"] = "standing" if stated is None else source
    mass = measured if stated is None else stated
    if not mass > 0.0:
        raise InputError(
            f"{listed(settings.standing.forces)}: standing gives a body "
            f"mass of {mass:.1f} kg; check standing.plates"
        )
    return mass


def _scaled(
    settings: RecordingSettings, mass: float, model: MarkerModel
) -> HumanParameters:
    """De Leva's tables; lengths and ankle height measured if so set."""
    subject = settings.subject
    human = scale_human(mass, subject.height_m, subject.sex)
    if settings.scaling.lengths == "markers":
        human = replace(
            human,
            shank=_stretched(human.shank, model.lengths_m["shank"]),
            thigh=_stretched(human.thigh, model.lengths_m["thigh"]),
        )
        human = _raised(human, model.ankle_height_m)
    return human


def _as_modelled(
    human: HumanParameters, mass: float, model: MarkerModel, poses
) -> HumanParameters:
    """The OpenSim model's person, scaled to a mass, soles on the floor.

    If the model's feet are pitched in standing, the spheres are placed so that
    they touch the floor in that posture.
    """
    ratio = mass / human.mass_kg
    parts = {name: getattr(human, name).heavier(ratio) for name in SEGMENTS}
    if human.toes is not None:
        parts["toes"] = human.toes.heavier(ratio)
    height = model.ankle_height_m
    feet = [model.index("foot", side) for side in model.sides]
    level = np.exp(-1j * poses.angles[:, feet].mean())

    def on_floor(point: tuple[float, float]) -> tuple[float, float]:
        p = level * complex(point[0], CONTACT_RADIUS_M - height)
        return float(p.real), float(p.imag)

    return replace(
        human,
        ankle_height_m=height,
        heel_m=on_floor(human.heel_m),
        toe_m=on_floor(human.toe_m),
        **parts,
    )


def _stretched(segment: SegmentParameters, length: float):
    """The segment at another length [m]; same mass, scaled CoM and inertia."""
    ratio = length / segment.length_m
    return replace(
        segment,
        length_m=length,
        com_m=tuple(ratio * c for c in segment.com_m),
        inertia_kg_m2=ratio**2 * segment.inertia_kg_m2,
    )


def _raised(human: HumanParameters, ankle_height: float) -> HumanParameters:
    """The person with a measured ankle height [m]; spheres on the floor."""
    ratio = ankle_height / human.ankle_height_m
    sphere_z = CONTACT_RADIUS_M - ankle_height
    return replace(
        human,
        ankle_height_m=ankle_height,
        heel_m=(human.heel_m[0], sphere_z),
        toe_m=(human.toe_m[0], sphere_z),
        foot=replace(
            human.foot, com_m=(human.foot.com_m[0], ratio * human.foot.com_m[1])
        ),
    )


def _check_centres(given: HumanOverrides, human: HumanParameters) -> None:
    """Refuse a given centre of mass that is not in its segment.

    That of a limb or trunk lies between its ends, near the line of its joints.
    """
    for name in CUFFED:
        if getattr(given, name).com_m is None:
            continue
        x, z = getattr(human, name).com_m
        length = getattr(human, name).length_m
        if not (abs(x) <= 0.25 * length and 0.0 <= z <= length):
            raise InputError(
                f"subject.segments.{name}.com_m is [{x:g}, {z:g}], which is "
                f"not in the {name}, {length:.3g} m long; give [x, z] in m, x "
                "forward and z up from its lower joint"
            )


def _check_height(source: str, ankle_height: float) -> None:
    if not ANKLE["minimum"] < ankle_height < ANKLE["maximum"]:
        raise InputError(
            f"{source}: the ankles are {ankle_height:.3f} m above the floor in "
            "standing; check markers.joint_centres.ankle and that the "
            "laboratory's floor is at zero height"
        )


def _with_device(settings: RecordingSettings, human: HumanParameters) -> Model:
    device = None
    if settings.assembly.is_fitted:
        device = fit_exoskeleton(human, settings.exoskeleton)
    return Model(settings.model, human, device, settings.gravity_m_s2)


def _over_the_cop(settings, model: Model, q, wrench, report) -> HumanParameters:
    """Shift the trunk's CoM fore-aft until the body's is above the CoP."""
    if wrench is None:
        raise InputError(
            "scaling.trunk_com is 'standing', which needs standing.forces "
            "and standing.plates; add them or say 'table'"
        )
    human, tree = model.human, model.rigid.tree
    gap = wrench.cop_x[0] - tree.center_of_mass(q)[0, 0]
    pelvis = human.pelvis
    dx = float(gap * tree.mass / pelvis.mass_kg)
    report["trunk_com_shift_m"] = dx
    if abs(dx) > 0.15:
        raise InputError(
            f"{listed(settings.standing.forces)}: standing puts the trunk's "
            f"centre of mass {dx:.2f} m off the hips; check that markers and "
            "plates share one origin, laboratory.marker_axes and force_axes, "
            "the unit of the plates' points (m, not mm), and standing.plates"
        )
    com = (pelvis.com_m[0] + dx, pelvis.com_m[1])
    return replace(human, pelvis=replace(pelvis, com_m=com))
