"""My engine, my contact: the parameters of one contact, written into a scene of MuJoCo, and what the ball does.

A ball of 0.5 kg meets a fixed plane at 1 m/s, and is to leave with e = 0.7 from a contact of 1e6 N/m. This project
gives the numbers of MuJoCo's ``solref`` and ``solimp``; the engine alone does the rest. ``impact-xval contact`` prints
the same.
"""

import mujoco

from impact_xval.compliant_baselines.contact.mapping import Contact, mujoco_contact

MASS, SPEED, E, STIFFNESS = 0.5, 1.0, 0.7, 1e6

contact = Contact.from_restitution(STIFFNESS, E, MASS)
pasted = mujoco_contact(contact)
step = contact.period / 1000
scene = f"""
<mujoco>
  <option timestep="{step:.9g}" gravity="0 0 0" integrator="Euler" solver="Newton"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body pos="0 0 0.1">
      <joint type="slide" axis="0 0 1"/>
      <geom name="ball" size="0.1" mass="{MASS}"/>
    </body>
  </worldbody>
  <contact>
    <pair geom1="floor" geom2="ball" condim="1" margin="0" gap="0"
          solref="{pasted.solref[0]:.12g} {pasted.solref[1]:.12g}"
          solimp="{" ".join(f"{number:g}" for number in pasted.solimp)}"/>
  </contact>
</mujoco>
"""

model = mujoco.MjModel.from_xml_string(scene)
data = mujoco.MjData(model)
data.qvel[0] = -SPEED
pushing = 0  # steps in which the contact carries a force: it ends before the ball is back at its height
for _ in range(1000):
    mujoco.mj_step(model, data)
    pushing += bool(data.nefc and data.efc_force[0] > 0)

returned = data.qvel[0] / SPEED
print(f"solref = {pasted.solref[0]:.6g} {pasted.solref[1]:.6g}")
print(f"restitution: asked {E}, got {returned:.4f}")
print(f"duration: asked {contact.duration * 1e3:.3f} ms, got {pushing * step * 1e3:.3f} ms")
assert abs(returned - E) < 1e-3
assert abs(pushing * step - contact.duration) < 2 * step
