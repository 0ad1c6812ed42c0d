"""Flight software of the arm: pure, without files, clocks or randomness; `fsw.cycle` is the way in.

Names that mean the same everywhere; joints and links from the rover outward, batch axes last:

- `q`, `output_rad`, `motor_rad`: angles of the outputs, and of the motors over the gear ratio, shape (5, ...)
- `gear_rad`: output less motor angles, shape (5, ...), or lowest, likely and highest ones, shape (5, 3)
- `half_backlash_rad`: half the width of the backlash, shape (5,)
- `load_Nm`, `torque_Nm`: torques of the load on the outputs, positive towards positive angles, shape (5, ...)
- `strain`: displacements of the springs in rad and m, rotation first, links second, shape (6, 6, ...); None
  for the rigid arm
- `more_Nm`: further uncertainty of the loads, shape (5,)
- `gravity_R_m_s2`: gravity in the rover frame RMECH, shape (3,) or (3, ...); zero for the rigid arm
- `p_RoTo_R_m`, `approach_R`: position of a tool in RMECH, and unit vector along its x axis, shape (3, ...)
- `last_rad`: set-point that went out last, shape (5,)
"""
