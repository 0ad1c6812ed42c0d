"""Settings of the MuJoCo library in a process that runs plants."""

import mujoco

from sim.mujoco_settings import apply_settings


def test_the_profiler_of_mujoco_is_off() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    seconds = []
    for switch in (lambda: mujoco.set_mjcb_time(None), apply_settings):
        switch()
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data)
        seconds.append(data.timer[0].duration)
    assert seconds[0] > 0.0 == seconds[1]
