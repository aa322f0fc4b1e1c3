"""Other names of robots.

These are short names of the usual robot of a family, and names in the registry of strands-robots [read: its
``robots.json``]. Spellings that differ only in case or punctuation (``Koch-v1.1``) need no row. A driver declares
the names of its robots in its ``robots.toml``.
"""

from __future__ import annotations

from collections.abc import Mapping

_NAMES: Mapping[str, str] = {
    "booster_t1": "booster",
    "crazyflie": "cf2 bitcraze_crazyflie",
    "earthrover": "earth_rover earthrover_mini_plus frodobots",
    "fr3": "franka_fr3",
    "fr3_v2": "franka_fr3_v2",
    "kinova_gen3": "gen3",
    "kuka_iiwa": "iiwa iiwa14 kuka_iiwa_14",
    "microduck": "micro_duck pollen_microduck",
    "open_duck_mini": "bdx mini_bdx open_duck_v2",
    "panda": """franka franka_emika_panda franka_panda libero_panda bimanual_panda_gripper bimanual_panda_hand
        single_panda_gripper oxe_droid oxe_droid_rel oxe_droid_relative_eef_relative_joint""",
    "rby1": "rby1a rainbow_rby1",
    "reachy_mini": "reachy pollen_reachy_mini",
    "robotiq_2f85": "robotiq",
    "so100": "so100_4cam so100_dualcam trs_so_arm100",
    "so101": "robotstudio_so101 so101_dualcam so101_tricam",
    "spot": "boston_dynamics_spot",
    "stretch": "hello_robot_stretch_original",
    "stretch3": "hello_robot_stretch_3",
    "unitree_g1": """g1_wbc unitree_g1_wbc unitree_g1_real unitree_g1_sonic unitree_g1_full_body
        unitree_g1_locomanip real_g1_relative_eef_relative_joints""",
    "xarm7": "xarm ufactory_xarm7",
    "yahboom_m3pro": "m3pro rosmaster_m3pro yahboom_rosmaster_m3_pro",
}
SHORT_NAMES: Mapping[str, str] = {short: robot for robot, names in _NAMES.items() for short in names.split()}
"""Other name -> robot."""
