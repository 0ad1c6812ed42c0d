"""A valid scenario file and edits that make it wrong: text, replacement, and begin of the message."""

GOOD = """\
title = "T"
summary = "S."
start = "ready"

[world]
tilt_roll_deg = 5
[world.surface]
position_m = [2.0, 0.0, -0.2]
normal = [0.0, 0.0, -1.0]

[[teach]]
name = "inlet"
tool = "portion"
position_m = [0.62, 0.05, -1.175]
approach = [0.0, 0.0, 1.0]

[[command]]
type = "MOVE_TOOL"
tool = "apxs"
position_m = [2.0, 0.0, -0.3]
approach = [0.0, 0.0, 2.0]

[[command]]
type = "PLACE_TOOL"
tool = "apxs"
position_m = [2.0, 0.0, -0.2]
approach = [0.0, 0.0, 3.0]

[[command]]
type = "RETRACT"
tool = "APXS"
distance_mm = 100

[[command]]
type = "MOVE_JOINT"
joint = "elbow"
angle_deg = 100

[[fault]]
type = "POWER_LOSS"
at_s = 100

[[check]]
type = "done"

[[check]]
type = "placed"
after = 2
tool = "apxs"
"""

DEAF = '"SENSOR_FAULT"\nsensor = "'
BAD = [
    ("distance_mm = 100", "distance_m = 5000", "command[3].distance_m: 5000 is outside"),
    ("tilt_roll_deg = 5", "tilt_rol_deg = 5", "world.tilt_rol_deg: is not known here"),
    ('start = "ready"', 'begin = "ready"', "begin: is not known here; there"),
    ("distance_mm = 100", "distance_mm = 100\nangle_deg = 1", "command[3].angle_deg: is not known here"),
    (
        "position_m = [2.0, 0.0, -0.3]",
        "position = 2",
        "command[1].position: has no unit; write position_m or",
    ),
    ("angle_deg = 100", "angle_mm = 100", "command[4].angle_mm: has another unit; write angle_rad or"),
    ("angle_deg = 100", "angle_deg = 100\nangle_rad = 1.0", "command[4].angle_rad: angle_deg sets the same"),
    ('"MOVE_TOOL"', '"MOVE_TOLL"', "command[1].type: 'MOVE_TOLL' is not known; did you mean MOVE_TOOL?"),
    ('type = "RETRACT"\n', "", "command[3].type: is missing; there are"),
    ('"APXS"', '"spoon"', "command[3].tool: 'spoon' is not known; did you mean portion? there are drill"),
    ('"elbow"', '"elbo"', "command[4].joint: 'elbo' is not known; did you"),
    ('"APXS"', "3", "command[3].tool: 3 is not known; there are drill"),
    ("distance_mm = 100", 'distance_mm = "100"', "command[3].distance_mm: should be a valid number, not"),
    ("distance_mm = 100", "distance_mm = inf", "command[3].distance_mm: should be a finite"),
    ("[0.0, 0.0, 2.0]", "[0.0, 1.0]", "command[1].approach[3]: is missing; add it"),
    ("normal = [0.0, 0.0, -1.0]", "normal = [0, 0, 'up']", "world.surface.normal[3]: should be a valid"),
    ("distance_mm = 100\n", "", "command[3].distance_m or distance_mm: is missing"),
    ("2.0]", '2.0]\nframe = "RNAW"', "command[1].frame: 'RNAW' is not known; did you mean RNAV?"),
    ("3.0]", '3.0]\nframe = "ARM3"', "command[2].frame: 'ARM3' is not known; there are RNAV, RMECH"),
    ("distance_mm = 100", 'distance_mm = 100\nframe = "RNAV"', "command[3].frame: is not known here"),
    ("2.0]", '2.0]\nbranch = "aut"', "command[1].branch: 'aut' is not known; did you mean auto?"),
    ("3.0]", "3.0]\nnormal = [0, 0, 1]", "command[2]: PLACE_TOOL: the normal points along the approach, not"),
    ("m = [2.0, 0.0, -0.3]", "mm = [-2e4, 0, 0]", "command[1].position_mm: in RMECH, number 1: -20.09002 is"),
    ("angle_deg = 100", f"angle_deg = {'9' * 4301}", "is not TOML: a whole number has more than 4300 digits"),
    (
        'MOVE_JOINT"\njoint = "elbow"\nangle_deg = 100',
        'DOCK"\npoint = "inlit"',
        "command[4].point: 'inlit' is not known; did you mean inlet?",
    ),
    ("after = 2", "after = 9", "check[2].after: there is no command 9; they"),
    ('name = "inlet"', 'name = ""', "teach[1].name: '' is empty or taken; give each its own"),
    ("at_s = 100", "during = 0\nafter_s = 1", "fault[1].during: there is no command 0; they are numbered 1"),
    (
        '"POWER_LOSS"',
        f'{DEAF}switch_closed"\nkind = "nan"',
        "fault[1]: switch_closed cannot read nan; write frozen",
    ),
    (
        '"POWER_LOSS"',
        f'{DEAF}resolver_rad"\nkind = "nan"\nindex = 5',
        "fault[1]: index: 5 is outside 0 .. 4, the",
    ),
    (
        '"POWER_LOSS"',
        f'{DEAF}switch_closed"\nkind = "biased"\nsize = 1\nindex = 12',
        "fault[1]: index: 12 is outside 0 .. 9",
    ),
    ('"POWER_LOSS"', '"WEAK_MOTOR"\njoint = "elbow"\nfactor = 2', "fault[1].factor: 2 is outside 0 .. 1"),
    ("normal = [0.0, 0.0, -1.0]", "normal = [0, 0, 0]", "world.surface.normal: has no length"),
    ('type = "done"', 'type = "faulted"\nevr = "ContactMade"', "check[1].evr: 'ContactMade' is not known"),
    (
        GOOD[GOOD.index("[world.surface]") : GOOD.index("[[teach]]")],
        '[[fault]]\ntype = "ROCK_GONE"\nat_s = 1\n',
        "fault[1]: ROCK_GONE: there is no rock; write [world.surface]",
    ),
    ("at_s = 100\n", "", "fault[1].at_s: is missing; or give during, the number"),
    ("at_s = 100", "at_s = 100\nafter_s = 1", "fault[1].at_s: counts from the"),
    ("at_s = 100", "during = 1", "fault[1].after_s: is missing"),
    ('start = "ready"', 'start = "ready"\narm = "asbuilt"', "arm: arm 'asbuilt' is not known; write"),
    ("[world]", '[world]\nscene = "moon"', "world.scene: 'moon' is not known; there are mars, earth"),
    ("tilt_roll_deg = 5", "tilt_roll_deg = 35", "world: tilts the rover by 35 deg; the arm is used up to"),
    ("[world]\ntilt_roll_deg = 5\n[world.surface]", "world = 5\n[surface]", "world: 5 is no table; write"),
    ("[[fault]]", "[fault]", "fault: is no list of tables; write [[fault]]"),
    (
        "[world.surface]\nposition_m = [2.0, 0.0, -0.2]\nnormal = [0.0, 0.0, -1.0]\n",
        "",
        "check[2]: placed: there is nothing to touch; write [world.surface]",
    ),
    ('type = "done"', 'type = "stowed"', "check: none says how the scenario ends; add one of"),
    ("tilt_roll_deg = 5", "tilt_roll_deg = = 5", "is not TOML: Invalid value"),
]
