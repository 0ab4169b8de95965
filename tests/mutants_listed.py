"""Which tests are meant for which file, and errors worth planting."""

_CALIBRATION = ["tests/calibration/test_costs.py", "tests/calibration"]
_LABORATORY = "tests/virtual_laboratory"
_SOLES = "tests/soles"

# Folder or file -> tests; those of the longest fitting name run first.
TESTS = {
    "drake_exo/": ["tests/test_api.py", "tests/test_study.py"],
    "drake_exo/study.py": [
        "tests/test_api.py",
        "tests/test_study.py",
        "tests/calibration/test_bands.py",
    ],
    "drake_exo/batch/": ["tests/batch"],
    "drake_exo/jobs/": ["tests/jobs", "tests/batch"],
    "drake_exo/calibration/": _CALIBRATION,
    "drake_exo/calibration/audit.py": [
        "tests/calibration/test_audit.py",
        "tests/calibration/test_scores.py",
    ],
    "drake_exo/calibration/uncertainty.py": [
        "tests/calibration/test_bands.py",
        "tests/calibration/test_identifiability.py",
    ],
    "drake_exo/calibration/clocks.py": [
        "tests/calibration/test_clocks.py",
        "tests/measurement/test_processing.py",
    ],
    "drake_exo/calibration/error_model.py": [
        "tests/calibration/test_error_model.py"
    ],
    "drake_exo/calibration/results.py": [
        "tests/calibration/test_results.py",
        "tests/calibration/test_bands.py",
    ],
    "drake_exo/calibration/design": [
        "tests/calibration/test_design_program.py",
        "tests/calibration/test_design.py",
    ],
    "drake_exo/calibration/phases.py": ["tests/calibration/test_periodic.py"],
    "drake_exo/calibration/settings.py": [
        "tests/docs/test_pages.py::test_keys_are_those_of_the_program",
        "tests/calibration/test_wearers.py",
    ],
    "drake_exo/calibration/solving.py": ["tests/calibration/test_verdicts.py"],
    "drake_exo/calibration/start.py": ["tests/calibration/test_start.py"],
    "drake_exo/calibration/wearers.py": [
        "tests/calibration/test_wearers.py",
        "tests/test_design_cuffs.py",
    ],
    "drake_exo/contact/strap.py": [
        "tests/contact/test_assistance.py",
        "tests/contact/test_strap.py",
        "tests/calibration/test_design_program.py",
    ],
    "drake_exo/contact/bushing.py": [
        "tests/contact/test_bushing.py",
        "tests/collocation/test_kernels.py",
        "tests/collocation/test_bushing_kernels.py",
        "tests/collocation/test_curvature.py",
    ],
    "drake_exo/designed.py": [
        "tests/test_designed.py",
        "tests/test_designing.py",
    ],
    "drake_exo/designing.py": [
        "tests/test_designed.py",
        "tests/test_designing.py",
        "tests/test_design_cuffs.py",
        "tests/calibration/test_design.py",
    ],
    "drake_exo/cli/": ["tests/cli", "tests/test_cli.py", "tests/test_view.py"],
    "drake_exo/cli/batch.py": [
        "tests/cli",
        "tests/batch/test_batch_command.py",
    ],
    "drake_exo/cli/calibrate.py": [
        "tests/cli",
        "tests/calibration/test_calibrate_command.py",
    ],
    "drake_exo/cli/check.py": ["tests/measurement/test_check_command.py"],
    "drake_exo/cli/design.py": ["tests/test_designing.py"],
    "drake_exo/cli/predict.py": ["tests/calibration/test_predict_command.py"],
    "drake_exo/cli/sole.py": ["tests/cli", f"{_SOLES}/test_sole_validity.py"],
    "drake_exo/collocation/": ["tests/collocation", *_CALIBRATION],
    "drake_exo/collocation/bushing_kernels.py": [
        "tests/collocation/test_design_kernels.py",
        "tests/collocation/test_curvature.py",
        "tests/calibration/test_design_program.py",
    ],
    "drake_exo/collocation/trial_program.py": [
        "tests/collocation/test_trial_program.py"
    ],
    "drake_exo/contact/": ["tests/contact", *_CALIBRATION],
    "drake_exo/files/": ["tests/files", "tests/measurement"],
    "drake_exo/files/osim.py": [
        "tests/files/test_osim.py",
        "tests/report/test_opensim_export.py",
    ],
    "drake_exo/measurement/": ["tests/measurement"],
    "drake_exo/measurement/plausibility.py": [
        "tests/measurement/test_plausibility_numbers.py",
        "tests/measurement/test_plausibility.py",
    ],
    "drake_exo/model/": ["tests/model", "tests/measurement"],
    "drake_exo/model/planar_tree.py": ["tests/model", "tests/collocation"],
    "drake_exo/nlp/": ["tests/nlp", *_CALIBRATION],
    "drake_exo/papers/": [
        "tests/report",
        f"{_SOLES}/test_sole_study.py",
        f"{_SOLES}/test_sole_optimise.py",
    ],
    "drake_exo/papers/de_magistris.py": ["tests/papers"],
    "drake_exo/player/": ["tests/player", "tests/report/test_replay.py"],
    "drake_exo/report/": ["tests/report"],
    "drake_exo/report/figures.py": ["tests/report/test_figures.py"],
    "drake_exo/report/opensim_export.py": [
        "tests/report/test_opensim_export.py"
    ],
    "drake_exo/report/gathering.py": ["tests/report/test_tables.py"],
    "drake_exo/soles/": [_SOLES],
    "drake_exo/soles/animation.py": [
        f"{_SOLES}/test_animation_numbers.py",
        f"{_SOLES}/test_sole_replay.py",
    ],
    "drake_exo/soles/contact/": [
        f"{_SOLES}/test_node_law.py",
        f"{_SOLES}/test_newton_matrix.py",
        f"{_SOLES}/test_step_starts.py",
        f"{_SOLES}/test_sole_contact.py",
    ],
    "drake_exo/soles/finite_strain.py": [
        f"{_SOLES}/test_neo_hookean.py",
        f"{_SOLES}/test_finite_strain.py",
        f"{_SOLES}/test_strain_numbers.py",
    ],
    "drake_exo/soles/contact/law.py": [
        f"{_SOLES}/test_kept_files.py",
        f"{_SOLES}/test_ground.py",
    ],
    "drake_exo/soles/elasticity.py": [
        f"{_SOLES}/test_fronts.py",
        f"{_SOLES}/test_sole_elasticity.py",
    ],
    "drake_exo/soles/load_blocks.py": [f"{_SOLES}/test_load_numbers.py"],
    "drake_exo/soles/loads.py": [f"{_SOLES}/test_load_numbers.py"],
    "drake_exo/soles/mesh.py": [
        f"{_SOLES}/test_sole_mesh.py",
        f"{_SOLES}/test_sole_stl.py",
    ],
    "drake_exo/soles/optimize/design.py": [f"{_SOLES}/test_design_numbers.py"],
    "drake_exo/soles/optimize/files.py": [f"{_SOLES}/test_kept_files.py"],
    "drake_exo/soles/optimize/limits.py": [f"{_SOLES}/test_limit_numbers.py"],
    "drake_exo/soles/optimize/problem.py": [
        f"{_SOLES}/test_problem_parts.py",
        f"{_SOLES}/test_limit_numbers.py",
        f"{_SOLES}/test_gait.py",
    ],
    "drake_exo/soles/optimize/optimizer.py": [
        f"{_SOLES}/test_optimizer.py",
        f"{_SOLES}/test_problem_parts.py",
    ],
    "drake_exo/soles/optimize/search.py": [f"{_SOLES}/test_search.py"],
    "drake_exo/soles/pictures.py": [
        f"{_SOLES}/test_sole_pictures.py",
        f"{_SOLES}/test_sole_views.py",
    ],
    "drake_exo/soles/numerics.py": [f"{_SOLES}/test_rotations.py"],
    "drake_exo/soles/results.py": [
        f"{_SOLES}/test_step_numbers.py",
        f"{_SOLES}/test_step_verdict.py",
    ],
    "drake_exo/soles/simulation.py": [
        f"{_SOLES}/test_step_starts.py",
        f"{_SOLES}/test_step_numbers.py",
    ],
    "drake_exo/soles/surface.py": [
        f"{_SOLES}/test_surface_steps.py",
        f"{_SOLES}/test_surface.py",
    ],
    "drake_exo/soles/walking_pattern.py": [
        f"{_SOLES}/test_walking_pattern.py",
        f"{_SOLES}/test_gait.py",
    ],
    "drake_exo/virtual_laboratory/": [
        f"{_LABORATORY}/test_instruments.py",
        f"{_LABORATORY}/test_truth.py",
        _LABORATORY,
    ],
    "drake_exo/virtual_laboratory/plan.py": [f"{_LABORATORY}/test_plan.py"],
    "drake_exo/virtual_laboratory/simulation.py": [
        f"{_LABORATORY}/test_simulation.py"
    ],
    "drake_exo/virtual_laboratory/two_legs.py": [
        f"{_LABORATORY}/test_uneven_legs.py",
        f"{_LABORATORY}/test_lab_walks.py",
    ],
    "drake_exo/virtual_laboratory/synthetic.py": [
        "tests/calibration/test_synthetic.py",
        "tests/calibration",
    ],
}

# File -> (what stands there exactly once, what is planted instead).
LISTED: dict[str, list[tuple[str, str]]] = {
    "drake_exo/calibration/start.py": [
        (
            "np.where(steep, missing / np.where(steep, slope, 1.0), 0.0)",
            "np.zeros(len(missing))",
        ),
        (
            "size = np.where(tree.coordinates.is_angle, _ANGLE_RAD, _LENGTH_M)",
            "size = np.ones(len(tree.coordinates))",
        ),
    ],
    "drake_exo/calibration/phases.py": [
        ("ahead[x] = speed * at.duration", "ahead[x] = speed"),
        ("quarter = (counts[longest] // 4 - 1e-6) * step", "quarter = -1e-6"),
        ("if c != NORMAL or cuff not in trial.cuffs", "if c != NORMAL"),
        ("*normal_force_terms(movement, at, noise, effects),", ""),
        ("at_ends[[0, -1]] = END_WEIGHT_S", "at_ends[0] = END_WEIGHT_S"),
        (
            "return [\n            *ground_terms(movement, at, noise),",
            "return [",
        ),
        (
            "everything = dict.fromkeys(self.bushings, EVERY)",
            "everything = dict.fromkeys(self.bushings, [1])",
        ),
    ],
    "drake_exo/calibration/wearers.py": [
        (
            "inertia_kg_m2=self.mass * self.height**2 * part.inertia_kg_m2",
            "inertia_kg_m2=self.mass * part.inertia_kg_m2",
        ),
        ("given - moments[:, device])", "given)"),
    ],
    "drake_exo/calibration/design.py": [
        (
            "w / w.sum() for w in weights]) / len(weights)",
            "w / w.sum() for w in weights])",
        ),
        (
            "np.hstack([rise, -np.diag(steps)])",
            "np.hstack([rise, -np.eye(len(steps))])",
        ),
        (
            "np.block([[eye, eye], [eye, -eye]])",
            "np.block([[eye, eye], [eye, eye]])",
        ),
        ("own - most, own + most)", "-most, most)"),
        ("np.deg2rad(limits.speed_deg_s)", "limits.speed_deg_s"),
        ("device - (at.device_moments - self.wearer.drive(at))", "device"),
        (
            "settings = replace(settings, weight=_LIGHT)",
            "settings = replace(settings, weight=10.0)",
        ),
        (
            "np.sqrt(settings.weight * share[used])[:, None]",
            "(settings.weight * share[used])[:, None]",
        ),
        ("most[NORMAL] /= differ", "most[NORMAL] /= 1.0"),
        (
            "MovedWeight(b, first + 1, segment, 1j * weight)",
            "MovedWeight(b, first + 1, segment, weight)",
        ),
        ("duration += len(design.removed) * trial.duration", "pass"),
    ],
    "drake_exo/collocation/bushing_kernels.py": [
        (
            "by_slips = force**5 * slip**2 * share**5",
            "by_slips = force**5 * slip**2",
        ),
        (
            "lever = -turned.imag * x[:, place]",
            "lever = turned.imag * x[:, place]",
        ),
        ("E[:, 2, 2] = f_s**2 + f * f_ss", "E[:, 2, 2] = f_s**2"),
    ],
    "drake_exo/collocation/kernels.py": [
        ("x[:, 1] * off[:, 0] - x[:, 0] * off[:, 1]", "x[:, 1] * off[:, 0]"),
        ("J[:, 2, 0] += off[:, 1]", "pass"),
        ("weights[:, 1] += x[:, 0] * weights[:, 2]", "pass"),
        ("H[:, :nq, :nq] -= self._load.bends(q, data, w)", "pass"),
    ],
    "drake_exo/collocation/initial_guess.py": [
        (
            "v[rows, 0] = slip - (q[rows, 1] - height) * v[rows, 2]",
            "v[rows, 0] = slip",
        ),
    ],
    "drake_exo/contact/reduction.py": [
        (
            "np.sqrt(variance * 2 * best.cost / spare)",
            "np.sqrt(variance * best.cost / spare)",
        ),
    ],
    "drake_exo/model/planar_tree.py": [
        ("own -= (lever * base[:, None]).imag", "pass"),
        ("own = (by_angle - turned) * (F_x * z", "own = by_angle * (F_x * z"),
    ],
    "drake_exo/model/description.py": [
        (
            "inertia_kg_m2=foot.inertia_kg_m2 * plate_ratio**2",
            "inertia_kg_m2=foot.inertia_kg_m2 * plate_ratio",
        ),
    ],
    "drake_exo/model/plant.py": [
        ("float(np.rad2deg(angle))", "float(angle)"),
    ],
    "drake_exo/nlp/ipopt.py": [
        (
            "scaled.AddQuadraticCost(Q, cost.b() * unit,",
            "scaled.AddQuadraticCost(Q, cost.b(),",
        ),
    ],
    "drake_exo/nlp/sparse.py": [
        (
            "violation = np.maximum(self.g_lower - g, g - self.g_upper)",
            "violation = g - self.g_upper",
        ),
    ],
    "drake_exo/calibration/audit.py": [
        ("np.where(known, values, 0.0) ** 2", "np.where(known, values, 0.0)"),
        ("found.q - at.q", "found.q + at.q"),
        ("measured.sample(found.times)", "measured"),
        ('"x_mm": float(1e3 * x)', '"x_mm": float(1e2 * x)'),
        ('"z_mm": float(1e3 * z)', '"z_mm": float(1e3 * x)'),
        ("float(np.rad2deg(pitch))", "float(pitch)"),
        ("float(1e3 * rms(off, times)[0])", "float(rms(off, times)[0])"),
        ("wrench.cop_x - measured_wrench.cop_x", "wrench.cop_x"),
        (
            "np.rad2deg(values[names.joint_columns])",
            "values[names.joint_columns]",
        ),
        (
            "_of_joints(names, d_q), _of_joints(names, d_v)",
            "_of_joints(names, d_q), _of_joints(names, d_q)",
        ),
        ("ddof=1", "ddof=0"),
        (
            "np.linspace(0.0, t.duration, _PHASE_SAMPLES)",
            "np.linspace(0.0, 1.0, _PHASE_SAMPLES)",
        ),
        (
            "- tree.point_positions(t.q, foot)[:, 0]",
            "",
        ),
        ("if at.moments is not None and loads", "if at.moments is not None"),
        ("FORCE_TOLERANCE = 1.0", "FORCE_TOLERANCE = 10.0"),
        (
            '"audit", self.moment_nm, MOMENT_TOLERANCE',
            '"audit", self.moment_nm, FORCE_TOLERANCE',
        ),
        (
            "np.rad2deg(simulated.q - found.q)[:, joints]",
            "(simulated.q - found.q)[:, joints]",
        ),
        ("simulated.ground.force - found.ground.force", "found.ground.force"),
        ("float(angles.max())", "float(angles.min())"),
        ("dynamics = FORCE_UNIT * movement", "dynamics = movement"),
        (
            "WRENCH_UNITS * problem.kernels[body].evaluate(x, None)",
            "problem.kernels[body].evaluate(x, None)",
        ),
        ("forces.append(contact[:, :2])", "pass"),
        ("moments.append(contact[:, 2:])", "pass"),
        ("[dynamics[:, is_angle]]", "[np.zeros((len(times), 1))]"),
        ("np.abs(part[kind]).max(axis=1)", "part[kind].max(axis=1)"),
        ("value = result.contact.values()", "value = problem.contact.values()"),
    ],
    "drake_exo/calibration/uncertainty.py": [
        ("QUANTILE_95 = 1.959964", "QUANTILE_95 = 1.644854"),
        ("np.hypot(self.sd, self.pull)", "self.sd"),
        ("np.where(self.at_bound, np.nan, sd)", "sd"),
        ("off < _IDENTIFIABLE * self.prior_sd", "off < self.prior_sd"),
        (
            "covariance = -unit[:, None] * found[:, columns] * unit",
            "covariance = -unit[:, None] * found[:, columns]",
        ),
        (
            "yield (R[:, :, r] * sigma[:, r]) @ values",
            "yield R[:, :, r] @ values",
        ),
        ("np.hstack([-omega * s, omega * c])", "np.hstack([-s, c])"),
        (
            "(np.sqrt(2.0) - 1.0) * (frequencies / cutoff_hz) ** order",
            "(frequencies / cutoff_hz) ** order",
        ),
        ("J[:, 0] / noise.force_n,", "J[:, 0] / noise.cop_m,"),
        (
            "d_cop = -(J[:, 2] + cop * J[:, 1]) / load",
            "d_cop = -J[:, 2] / load",
        ),
        ("DISCREPANCY = 0.12", "DISCREPANCY = 0.24"),
        ("np.abs(shown - predicted) <= width", "shown - predicted <= width"),
        ("at, names = measured.sample(found.times)", "at, names = measured"),
        (
            "at.v, found.v + self.off_v, self.seen_v",
            "at.v, found.v + self.off_v, self.seen_q",
        ),
        ("                problem.settings.noise.normal_force_n,\n", ""),
        (
            "return change_of(variables) + by @ moved[errors]",
            "return change_of(variables)",
        ),
        ("by @ known_errors for", "0.0 * by @ known_errors for"),
        ("R -= np.einsum(", "R += np.einsum("),
        ("covariance += by_errors @", "covariance -= by_errors @"),
        ("            term.sigma[0],\n", ""),
        ("change[errors] = -np.linalg.inv(prior)", "pass"),
        ("parts = [np.hstack(moved) @ _root(covariance)]", "parts = []"),
        ("modes[:, 0] = np.sqrt(1.0 / duration)", "modes[:, 0] = 1.0"),
        ("gain = term.weights / term.sigma[:, k]", "gain = term.weights"),
        ("return QUANTILE_95 * np.sqrt(variance)", "return np.sqrt(variance)"),
        (
            "_half_width(change_of(variables), law)",
            "_half_width(change_of(variables))",
        ),
    ],
    "drake_exo/calibration/clocks.py": [
        ("return QUANTILE_95 * self.sd_s", "return self.sd_s"),
        ("float(lag + late)", "float(late)"),
        (
            "np.array([c.lag_s - trial.lags_s.get(c.system, 0.0) for",
            "np.array([c.lag_s for",
        ),
        ("covariance[j, j] += more**2", "covariance[j, j] += more"),
        ("spline(old + late[system])", "spline(old - late[system])"),
        ("trial.times + trial.start_s - wide.start_s", "trial.times"),
        ("- wide.shifts_s.get(system, 0.0)", ""),
        ("() if result is None else result.trials", "()"),
        ("number > 0 and", ""),
        ("float(np.hypot(c.sd_s, x))", "c.sd_s"),
    ],
    "drake_exo/calibration/error_model.py": [
        ("moments[:, :, k] = self._moments(at, q, v, a, k)", "pass"),
        (
            "q[:, device, k] = -near.v[:, device]",
            "q[:, device, k] = near.v[:, device]",
        ),
        (
            "v[:, device, k] = -near.a[:, device]",
            "v[:, device, k] = -near.v[:, device]",
        ),
        ("normal[cuff][:, k] = -np.gradient(force, at.times)", "pass"),
        ("near = at if near is None else near.sample(at.times)", "near = at"),
        ("-trial.shifts_s.get(system, 0.0)", "0.0"),
        ("return f * f, 2.0 * f * rate", "return f * f, f * rate"),
        (
            "found[:, human] -= np.outer(change[:, i], names.turned_by[i])",
            "pass",
        ),
        ('-f if what == "unseen" else 1.0', 'f if what == "unseen" else 1.0'),
        ("np.deg2rad(sizes.encoder_offset_deg)", "sizes.encoder_offset_deg"),
        (
            "np.diag([u.sd**2 for u in self.unknowns])",
            "np.diag([u.sd for u in self.unknowns])",
        ),
    ],
    "drake_exo/study.py": [
        ('"lower": p.lower,', '"lower": p.upper,'),
        ('loads=self.phase != "foot-ground"', "loads=True"),
    ],
    "drake_exo/calibration/results.py": [
        (
            "degrees = np.where(names.is_angle, np.rad2deg(values), values)",
            "degrees = values",
        ),
        (
            "values.extend((middle - width, middle + width))",
            "values.extend((middle, middle + width))",
        ),
        ("unit[k] * found.v[:, k]", "unit[k] * found.q[:, k]"),
        (
            '"parameters": contact.values(),',
            '"parameters": dict.fromkeys(contact.values(), 1.0),',
        ),
        (
            "zip(_DAMPING, self.damping[c], strict=True)",
            "zip(_DAMPING[::-1], self.damping[c], strict=True)",
        ),
    ],
    "drake_exo/calibration/problem.py": [
        (
            "weight = 0.5 * np.linalg.inv(covariance)",
            "weight = np.linalg.inv(covariance)",
        ),
        ("np.r_[root_q, np.deg2rad(joint_q)]", "np.r_[root_q, joint_q]"),
        (
            "np.r_[root_v, np.deg2rad(joint_v)]",
            "np.r_[root_v, np.deg2rad(joint_q)]",
        ),
        ("of_device = noise.exo_moment_nm", "of_device = noise.moment_nm"),
        ("noise.cop_m * reference", "noise.cop_m"),
        (
            "np.sqrt(grid.quadrature[used])[:, None]",
            "grid.quadrature[used][:, None]",
        ),
        ("np.tile([1.0, 1.0, degree], 2)", "np.ones(6)"),
        ("variables[:, [NORMAL]],", "variables[:, [0]],"),
    ],
    "drake_exo/collocation/trial_program.py": [
        ("weight = 0.5 / p.prior_sd**2", "weight = 1.0 / p.prior_sd**2"),
        (
            "return np.log(x / self._middle) / self._sd",
            "return np.log(x / self._middle)",
        ),
        (
            "np.diag(1.0 / self.jerk_sigma**2)",
            "np.diag(1.0 / self.jerk_sigma)",
        ),
        ("y = term.target / term.sigma", "y = term.target"),
    ],
    "drake_exo/contact/bushing.py": [
        (
            'if name.endswith(("_stiffness", "_damping"))',
            'if name.endswith("_stiffness")',
        ),
    ],
    "drake_exo/report/gathering.py": [
        ("np.std(known, ddof=1)", "np.std(known)"),
        (
            "row = [label, *values, *mean_and_sd(values)]",
            "row = [label, *values, *mean_and_sd(values[1:])]",
        ),
        ("row.append(lookup(spread, path))", "row.append(None)"),
        ('f"± {half:.2g}"', 'f"± {half / 2:.2g}"'),
        (
            '"velocities_deg_s": "velocity {} [deg/s]"',
            '"velocities_deg_s": "angle {} [deg/s]"',
        ),
        ('r["moment_nm"],', 'r["force_n"],'),
        ('if parameter["at_bound"]:', "if False:"),
        ('"weakly determined"', '""'),
        ('for e in ("", "_worst")', 'for e in ("_worst", "")'),
        ("f\"{p['lower']:.4g}\",", "f\"{p['upper']:.4g}\","),
    ],
    "drake_exo/report/figures.py": [
        ("np.rad2deg(read(t, name))", "read(t, name)"),
        (
            "getattr(t.soles[s], w)",
            'getattr(t.soles[s], "force_z")',
        ),
        ('Trial.coordinate, "°")', 'Trial.velocity, "°")'),
        ('Trial.velocity, "°/s")', 'Trial.velocity, "°")'),
        (
            "width = max(shown, 1.0) * after.bands.normal(cuff)",
            "width = after.bands.normal(cuff)",
        ),
        ("middle - width,", "middle,"),
        ('y = [r["grf_n"] for r in some]', 'y = [r["cop_mm"] for r in rows]'),
        ("t = trial.start_s + trial.times", "t = trial.times"),
        ("quality.residual[:, column]", "quality.residual[:, 0]"),
        (
            "values = [1e3 * value for _, value in items]",
            "values = [value for _, value in items]",
        ),
        (
            "t.cuffs[cuff].normal if cuff in t.cuffs",
            "t.cuffs[cuff].tangential if cuff in t.cuffs",
        ),
    ],
    "drake_exo/papers/serrancoli.py": [
        (
            "rows.append([name, *pair, pair[1] / pair[0]])",
            "rows.append([name, *pair, pair[0] / pair[1]])",
        ),
        (
            'names = {"foot-ground": "A", "interaction": "B"}',
            'names = {"foot-ground": "B", "interaction": "A"}',
        ),
        (
            'texts.get(path[-1], texts.get(path[0], ""))',
            'texts.get(path[0], "")',
        ),
    ],
    "drake_exo/measurement/plausibility.py": [
        (
            "_beyond(used.cop_x[bears], *sole[bears, :2].T)",
            "_beyond(used.cop_x[bears], *sole[bears, 2:].T)",
        ),
        (
            "force_z[bears][far].max(initial=0.0)",
            "force_z[bears].max(initial=0.0)",
        ),
        ('"encoder_stranger": (0.45,', '"encoder_stranger": (45.0,'),
        ("known[j]) - alone[i] - alone[j]", "known[j]) - alone[i]"),
        ("np.nanargmin(row)", "np.nanargmax(row)"),
        ("_SKIN * human,", "human,"),
        ("_WEIGHT * np.sin(pitch)", "_WEIGHT * pitch"),
        ("scale * (d - human).T.ravel()", "scale * d.T.ravel()"),
        ("and driven[0] == driven[1]", ""),
        ("np.eye(by.shape[1]) + by.T @ by", "by.T @ by"),
        ("own / max(other, 1e-9),", "other / max(own, 1e-9),"),
        ("100.0 * misfit(e, e)[0]", "misfit(e, e)[0]"),
        ("np.hypot(fits[i, i], fits[j, j])", "fits[i, i]"),
        ("best = min(best, (share, float(lag)))", "best = share, float(lag)"),
        ("1e3 * lag if is_told else 0.0", "1e3 * lag"),
        ("np.std(missed[known])", "np.abs(missed[known]).max()"),
        ("off[upright].mean(axis=0)", "off.mean(axis=0)"),
        ("(measured + device) / (stated + device)", "measured / stated"),
        ("off = measured / stated - 1.0", "off = measured / stated"),
        ("(moment - (z * F_x - x * F_z)) ** 2", "moment**2"),
    ],
    "drake_exo/virtual_laboratory/instruments.py": [
        ("_FORCE_NOISE_N = 0.5", "_FORCE_NOISE_N = 1.0"),
        ("_MOMENT_NOISE_NM = 0.2", "_MOMENT_NOISE_NM = 0.1"),
        (
            "_DRIFT = np.array([0.5, 1.5, 0.2])  #",
            "_DRIFT = np.array([0.5, 1.5, 2.0])  #",
        ),
        ("at = time - clocks.device", "at = time + clocks.device"),
        ("angles = angles + self.faults.encoder_offset_rad", "pass"),
        ("_ANGLE_STEP * np.round(angles / _ANGLE_STEP)", "angles"),
        ("moments + _EXO_MOMENT_NOISE_NM * noise[1]", "moments"),
        ("share += self.faults.left_share - 0.5", "pass"),
        (
            "values += np.linspace(0.0, 1.0, n)[:, None] * slope",
            "values += slope",
        ),
        ("values += self.offsets[place]", "pass"),
        ("rng.uniform(0.46, 0.54)", "rng.uniform(0.4, 0.6)"),
        ("float(rng.uniform(0.85, 1.0))", "float(rng.uniform(0.5, 1.0))"),
        ("reach = np.deg2rad(3.0)", "reach = np.deg2rad(6.0)"),
        ("torque[:, 2] = -(wrench.moment", "torque[:, 2] = (wrench.moment"),
        ("p = p + noise", "pass"),
        ("NOISE_M = 3e-4", "NOISE_M = 6e-4"),
        ("self.linear * f + self.quadratic * f * f", "self.linear * f"),
        (
            "before = np.arange(len(f)) - self.lag_s * rate_hz",
            "before = np.arange(len(f))",
        ),
        ("positions[:, i, 2] = -m.y_m", "positions[:, i, 2] = m.y_m"),
        (
            "(link * turn)[:, None] * (p - p.mean())",
            "(link * turn)[:, None] * p",
        ),
        (
            "p = flexion * turn * complex(*slide[i])",
            "p = turn * complex(*slide[i])",
        ),
        ("_STEP_PA = 2500.0", "_STEP_PA = 5000.0"),
        ("np.minimum(pressure, _LARGEST_PA)", "pressure"),
        ("np.interp(time - lag_s,", "np.interp(time,"),
        ("share *= self.faults.left_share", "share *= 0.5"),
        ("self.faults.mat_share.get(mat.cuff, 1.0)", "1.0"),
        ("for x in 1e-3 * p", "for x in p"),
        ("np.hypot(0.5 * normal, mat.tension_n)", "mat.tension_n"),
    ],
    "drake_exo/virtual_laboratory/plan.py": [
        (
            "share = chair.force_z / self.weight - wanted",
            "share = chair.force_z / self.weight",
        ),
        (
            "cop = ground.moment + plan.cop_m * ground.force_z",
            "cop = ground.moment",
        ),
        (
            "lean = posture.shank + np.rad2deg(gap / _HIP_HEIGHT_M)",
            "lean = posture.shank",
        ),
        (
            "return -np.array(self.viscous) * rates - dry",
            "return -np.array(self.viscous) * rates",
        ),
        ("np.tanh(rates / self.speed)", "np.tanh(rates)"),
        ("* error + self._damping * rate", "* error - self._damping * rate"),
        (
            "s = (share - low) / (high - low)",
            "s = share - low",
        ),
        ("held.append(rows[name] - pitch)", "held.append(rows[name] + pitch)"),
        (
            '- rows[f"hip_{side}"] - pitch',
            '- rows[f"hip_{side}"] + pitch',
        ),
    ],
    "drake_exo/virtual_laboratory/forces.py": [
        ("(cuff.progression * d) ** 2", "(cuff.progression * d)"),
        ("along / sqrt(1.0 + (cuff.slip * along) ** 2)", "along"),
        ("(force / factor) ** (2.0 / 3.0)", "(force / factor) ** (1.0 / 3.0)"),
    ],
    "drake_exo/virtual_laboratory/truth.py": [
        ("_CUFF_SLIP = 1.0 / 25.0", "_CUFF_SLIP = 1.0 / 50.0"),
        (
            "factors = {name: rng.uniform(0.97, 1.03) for name in names}",
            "factors = {name: rng.uniform(0.9, 1.1) for name in names}",
        ),
        (
            "_FRICTION = Friction(viscous=(0.3, 0.5, 0.5)",
            "_FRICTION = Friction(viscous=(0.3, 0.5, 0.05)",
        ),
        ('_CUFF_PROGRESSION if "progressive" in active else 0.0', "0.0"),
        (
            "inertia_kg_m2=ratio**2 * part.inertia_kg_m2",
            "inertia_kg_m2=ratio * part.inertia_kg_m2",
        ),
    ],
    "drake_exo/virtual_laboratory/campaign.py": [
        ("_AFTER_CHAIR_S = 0.08", "_AFTER_CHAIR_S = 0.8"),
        (
            "return plan.duration - plan.stand_s + _AFTER_RISE_S",
            "return plan.duration",
        ),
        (
            "rise_s=float(rng.uniform(1.2, 1.7))",
            "rise_s=float(rng.uniform(1.2, 2.7))",
        ),
        ("mats, clocks.mats)", "mats, clocks.device)"),
        ("gone = _SEEN_GONE_N", "pass"),
        ("share * viscous,", "viscous,"),
        ('section["estimate_encoder_delay"] = True', "pass"),
        ('"start_s": start_s', '"start_s": end_s'),
    ],
    "drake_exo/soles/load_blocks.py": [
        ("np.stack([x, -z, y], axis=1)", "np.stack([x, z, y], axis=1)"),
        ("column = 13 if self.foot", "column = 22 if self.foot"),
    ],
    "drake_exo/soles/mesh.py": [
        ("floor = 1e-9 * np.median(np.abs(mesh.volumes))", "floor = 1e-9"),
        ("WALL + np.ptp(mesh.nodes[:, 2])", "WALL"),
        ("2.0 * x / away", "x / away"),
    ],
    "drake_exo/soles/optimize/design.py": [
        ('1e6 * limits["volume"]', 'limits["volume"]'),
        ("step.c / before.c - 1", "step.c / before.c"),
    ],
    "drake_exo/soles/optimize/optimizer.py": [
        ("lam * values]", "lam]"),
        (
            "self.curvature.update(p, *self.at(p), multipliers / factor)",
            "self.curvature.update(p, *self.at(p), multipliers)",
        ),
        ("return False, finer, self", "return False, 0.0, self"),
    ],
    "drake_exo/soles/optimize/search.py": [
        ('_STRAIN_AIM * problem.limits["strain"]', 'problem.limits["strain"]'),
        ("step.c_rot / base.c_rot", "step.c_rot"),
        ("_AIM * floor * problem.first.c_rot", "_AIM * floor"),
        (
            "np.append(at.alone, setup.gait.walk(number))",
            "np.append(at.alone, setup.gait.start)",
        ),
        ('"c_tr_sole_alone": own.c_tr', '"c_tr_sole_alone": design.step.c_tr'),
        ("range(found.stage, len", "range(len(found.optima), len"),
        ("return -self.stage, *self", "return 0, *self"),
        ('if name != "c_rot")', ")"),
        ("sweep(weighing(_STEADY)", "sweep(free"),
        ("return not one.verdict().holds, one", "return one"),
    ],
    "drake_exo/soles/pictures.py": [
        ("axis.plot(*(1e3 * zmp[q])", "axis.plot(*(load.zmp[q])"),
        ("(0, high - low), text)", "(0, high), text)"),
        ("d + p[:, 1:] * [-1, 1]", "d + p[:, 1:]"),
        ("lit = _AMBIENT + _DIFFUSE", "lit = _AMBIENT - _DIFFUSE"),
    ],
    "drake_exo/soles/results.py": [
        ("zip(forces, load.force.T", "zip(forces, load.force[:, [0, 0, 2]].T"),
        ("angles = np.rad2deg(self.angles)", "angles = self.angles"),
        ('"volume_cm3": 1e6 * mesh.volume', '"volume_cm3": 1e3 * mesh.volume'),
        ('"mass_kg": mesh.volume * density', '"mass_kg": mesh.volume'),
        (
            "self.history.F[:, :, 2] / self.sole.mesh.contact_areas",
            "self.history.F[:, :, 2]",
        ),
        ("return self.costs[0]", "return self.costs[1]"),
        (
            "np.max(self.tilt_deg[self.converged], initial=0.0)",
            "np.max(self.tilt_deg, initial=0.0)",
        ),
        ("np.where(own[:, None], self.zmp, load.zmp)", "load.zmp"),
        ("margin.min() > 0)", "margin.max() > 0)"),
        ("P - Q) * law.penalty / scale", "P - Q) / scale"),
        ("margin = law.friction * f[:, 2] - size", "margin = f[:, 2] - size"),
        (
            "c_tr - self.setup.settings.cost.weight * c_rot",
            "c_tr - c_rot",
        ),
        (
            "float(by_rot[rows] @ self.sigma_min_rotation[rows])",
            "float(self.sigma_min_rotation[rows].mean())",
        ),
        ("c_rot / count,", "c_rot,"),
    ],
    "drake_exo/soles/simulation.py": [
        ("K_c[..., :3, :3])[..., 0]", "K_c[..., :3, :3])[..., -1]"),
        ("K_c[..., 3:, 3:])[..., -1]", "K_c[..., 3:, 3:])[..., 0]"),
        ("sym = -0.5 * (K_c", "sym = 0.5 * (K_c"),
        ("[1.0 / 0.05] * 3", "[0.05] * 3"),
        (
            "np.linalg.eigvalsh(np.nan_to_num(sym))[..., 0]",
            "np.linalg.eigvalsh(np.nan_to_num(sym))[..., -1]",
        ),
        (
            "int(fraction * samples + 1e-9)",
            "int(np.ceil(fraction * samples))",
        ),
        ("np.where(picked < strike, by_rot, 0.0)", "by_rot"),
        ("load.shares[load.phase[picked]]", "np.ones(len(picked))"),
        ("share * strike,", "strike,"),
        ("[rest] * (steps - q - 1)", "[rest] * (steps - q)"),
        ("pitch - np.arctan2(x, z), yaw", "pitch - np.arctan2(x, z), 0.0"),
    ],
    "drake_exo/soles/surface.py": [
        ("flat * 0.01 * h", "flat * 0.01"),
        ("back - 1e-6", "back"),
        ("np.cross(y, along)", "np.cross(along, y)"),
        ("low - 0.3183 * self.step", "low"),
        (
            "order[shared[which[order]] == 2] // 3",
            "order[shared[which[order]] == 2] // 2",
        ),
    ],
    "drake_exo/soles/optimize/problem.py": [
        ("others, by_walk[1:]", "others, 0 * by_walk[1:]"),
        ("m in (mesh, self.finer) if", "m in (mesh,) if"),
        ("share / grid.rest", "share"),
    ],
    "drake_exo/soles/walking_pattern.py": [
        ("low, high = low - rows @ p0", "low, high = low + rows @ p0"),
        ("x + s * d", "x + 2 * s * d"),
        (
            "share = smooth_share(t / D) * (1 - smooth_share((t - T) / D))",
            "share = smooth_share(t / D)",
        ),
        ("t, share[:, None] * total, self", "t, total, self"),
        ("begin + (t - first) * (end - begin)", "begin + (t - first) * 1.1"),
        ("if found == number:", "if found:"),
        ("out[late, 1] *= -1", "pass"),
        ("return s**3 * (10 - 15 * s + 6 * s**2)", "return s**2 * (3 - 2 * s)"),
        ("robot.step_width_m - points[:, 1]", "points[:, 1]"),
        (
            "own[rows] = line + z[rows] - (1 - share) * a - share * b",
            "own[rows] = z[rows]",
        ),
        (
            "return self.gravity_m_per_s2 / self.com_height_m",
            "return self.com_height_m / self.gravity_m_per_s2",
        ),
        ("forth, back = s - s**2 / (2 * D)", "forth, back = s - s**2 / D"),
    ],
    "drake_exo/virtual_laboratory/two_legs.py": [
        (
            "point = ankle + np.interp(at, *_POINT_M)",
            "point = np.interp(at, *_POINT_M)",
        ),
        (
            "v, a, torque = v @ other.T, a @ other.T, torque @ of_joints.T",
            "a, torque = a @ other.T, torque @ of_joints.T",
        ),
        (
            "return torque + swing + bears * (stance - swing)",
            "return torque + swing + bears * stance",
        ),
        ("stiffness=0.5 * sphere.stiffness", "stiffness=sphere.stiffness"),
        (
            "load = part * heavier * plan.ground.force_z",
            "load = part * plan.ground.force_z",
        ),
    ],
    "drake_exo/virtual_laboratory/simulation.py": [
        (
            "excess = loads - tree.inverse_dynamics(q, v, rest)",
            "excess = loads",
        ),
    ],
    "drake_exo/virtual_laboratory/synthetic.py": [
        (
            "model.human.ankle_height_m - 1e-3 - q[0, z]",
            "model.human.ankle_height_m - q[0, z]",
        ),
    ],
    "drake_exo/measurement/quality.py": [
        ("residual_nm=float(size[2])", "residual_nm=float(size[1])"),
        ("end_s=trial.start_s + trial.duration", "end_s=trial.duration"),
    ],
    "drake_exo/measurement/subject.py": [
        ("dx = float(gap * tree.mass / pelvis.mass_kg)", "dx = float(gap)"),
    ],
    "drake_exo/measurement/sagittal.py": [
        ("[F_x, F_z, zero, cop,", "[F_z, F_x, zero, cop,"),
        ("0.0, -share * wrench.moment)", "0.0, share * wrench.moment)"),
    ],
    "drake_exo/measurement/events.py": [
        (
            "share = 1.0 - minimum_jerk(away / _FADE_S)[0]",
            "share = 1.0 - away / _FADE_S",
        ),
    ],
    "drake_exo/files/osim.py": [
        (
            "return turn, motion + np.cross(turn, p_GQ - p_GM)",
            "return turn, motion + np.cross(turn, p_GQ)",
        ),
        (
            "first = slope - h * (s[1:] + 2.0 * s[:-1])",
            "first = slope - h * s[:-1]",
        ),
    ],
    "drake_exo/report/opensim_export.py": [
        ("held = b.slip / share * along", "held = b.slip * along"),
        ("turn = about_z(-poses[base][2])", "turn = about_z(poses[base][2])"),
    ],
    "drake_exo/papers/de_magistris.py": [
        ("name: (tr / tr0, rot / rot0)", "name: (tr0 / tr, rot / rot0)"),
    ],
    "drake_exo/jobs/engine.py": [
        ("job = job.told(**{job.given: values})", "pass"),
        ("line != self._last.get(job.name)", "True"),
    ],
}
