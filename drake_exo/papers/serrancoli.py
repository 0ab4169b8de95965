"""Figures that the paper prints, to stand beside ours.

Serrancoli et al., Results and Discussion; ranges and bounds as they stand in
the text, since its tables give them by trial of another subject.
"""

VIRTUAL_SUBJECT = "virtual_subject"

# Phase -> signal, or segment, -> text.
PAPER = {
    "A": {
        "angles_deg": "<= 0.8",
        "velocities_deg_s": "<= 6.5",
        "grf_n": "< 10",
        "cop_mm": "< 1",
    },
    "B": {
        "angles_deg": "<= 1.1",
        "velocities_deg_s": "<= 6.8",
        "grf_n": "8.4, worst 22.9",
        "moments_nm": "< 10",
        "pelvis": "5.4",
        "thigh": "2.3",
        "shank": "2.2",
    },
    "C1": {
        "angles_deg": "1.0 to 3.3",
        "velocities_deg_s": "6.1 to 14.3",
        "interaction_n": "<= 13.1",
    },
    "C2": {
        "angles_deg": "like C1",
        "velocities_deg_s": "like C1",
        "pelvis": "> 30",
        "thigh": "> 10",
    },
}
