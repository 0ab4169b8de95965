"""Asks OpenSim itself; run by a Python that has the opensim wheel.

    python tests/opensim_child.py REQUEST.json ANSWER.json

The request names a model file, and states: of a table of states, or values by
coordinate, speeds and accelerations likewise, and external forces (body ->
force and point in the ground). The answer holds generalized forces by
coordinate and what each force of the model records. Numbers pass as JSON, which
keeps all digits of a double.
"""

import json
import sys

import opensim


def piecewise(values):
    function = opensim.PiecewiseLinearFunction()
    for i, value in enumerate(values):
        function.addPoint(float(i), float(value))
    return function


def columns(rows):
    return [piecewise(column) for column in zip(*rows, strict=True)]


def push(model, body, forces, points):
    """A force on a body that the state's number, its time, looks up."""
    load = opensim.PrescribedForce(f"push_{body}", model.getBodySet().get(body))
    load.setForceIsInGlobalFrame(True)
    load.setPointIsInGlobalFrame(True)
    load.setForceFunctions(*columns(forces))
    load.setPointFunctions(*columns(points))
    model.addForce(load)


def in_tree_order(coordinates, state):
    """Names by their place among the generalized speeds."""
    found = {}
    for i in range(coordinates.getSize()):
        coordinate = coordinates.get(i)
        coordinate.setSpeedValue(state, 1.0)
        speeds = state.getU()
        (place,) = (k for k in range(speeds.size()) if speeds[k] != 0.0)
        found[place] = coordinate.getName()
        coordinate.setSpeedValue(state, 0.0)
    return [found[place] for place in sorted(found)]


def main(request, answer):
    with open(request) as file:
        asked = json.load(file)
    opensim.Logger.setLevelString("Error")
    model = opensim.Model(asked["model"])
    forces = model.updForceSet()
    for i in reversed(range(forces.getSize())):
        if opensim.Muscle.safeDownCast(forces.get(i)) is not None:
            forces.remove(i)
    for body, (force, point) in asked.get("pushes", {}).items():
        push(model, body, force, point)
    state = model.initSystem()
    if "states" in asked:
        return write(answer, {"records": of_table(model, asked["states"])})
    solver = opensim.InverseDynamicsSolver(model)
    coordinates = model.getCoordinateSet()
    order = in_tree_order(coordinates, state)
    found = {"tau": {name: [] for name in order}, "records": {}}
    for i in range(len(next(iter(asked["q"].values())))):
        for name in order:
            coordinate = coordinates.get(name)
            value = asked["q"].get(name)
            speed = asked["v"].get(name)
            coordinate.setValue(state, value[i] if value else 0.0, False)
            coordinate.setSpeedValue(state, speed[i] if speed else 0.0)
        state.setTime(float(i))
        model.realizeDynamics(state)
        udot = opensim.Vector(len(order), 0.0)
        for k, name in enumerate(order):
            if name in asked.get("a", {}):
                udot[k] = asked["a"][name][i]
        tau = solver.solve(state, udot)
        for k, name in enumerate(order):
            found["tau"][name].append(tau[k])
        record(model, state, found["records"])
    return write(answer, found)


def of_table(model, path):
    """What forces record at the states of a file."""
    table = opensim.TimeSeriesTable(path)
    states = opensim.StatesTrajectory.createFromStatesTable(model, table)
    found = {}
    for i in range(states.getSize()):
        state = states[i]
        model.realizeDynamics(state)
        record(model, state, found)
    return found


def record(model, state, found):
    """Append what each force of the model records."""
    for j in range(model.getForceSet().getSize()):
        force = model.getForceSet().get(j)
        labels = force.getRecordLabels()
        values = force.getRecordValues(state)
        own = found.setdefault(force.getName(), {})
        for k in range(labels.getSize()):
            own.setdefault(labels.get(k), []).append(values.get(k))


def write(answer, found):
    """Write the answer."""
    with open(answer, "w") as file:
        json.dump(found, file)


if __name__ == "__main__":
    main(*sys.argv[1:])
