"""MuJoCo scenes that users described in public, rebuilt from their numbers, with the restitutions they measured.

No text of a report is copied. Masses, radii, steps and contact parameters are those of the report. The rest of each
scene is kept as small as possible.
"""

#: Template of a scene: a ball above a floor.
BALL = """<mujoco><option timestep="{step}" {option}/><worldbody><geom name="floor" type="plane" size="5 5 1" {floor}/>
<body pos="0 0 1"><freejoint/><geom name="ball" size="{radius}" mass="{mass}" {ball}/></body></worldbody>
<contact>{pair}</contact></mujoco>"""

#: Template of a ball on a hinge, as in a cradle.
CRADLE_BALL = """<body name="b{i}" pos="{x} 0 1"><joint axis="0 1 0" pos="0 0 .5"/>
<geom name="b{i}" size="0.05" mass="{mass}" {contact}/></body>"""


def ball(**fields):
    """Fill the template of a ball above a floor with the given fields."""
    return BALL.format(**{"option": "", "floor": "", "ball": "", "pair": "", "step": 2e-3} | fields)


def too_high():
    """Return the ball of MuJoCo's discussion 3404. Its author wanted e = 0.75 and measured 0.8200."""
    contact = 'solref="-284244.6 -68.756" solimp=".998 .9999 .0002 .5 2"'
    return ball(mass=0.5, radius=0.1, step=2e-4, ball=contact, floor=contact)


def golf(damping=70):
    """Return a pendulum of 0.10 kg that strikes a ball of 0.045 kg.

    Its author measured e = 0.78 to 0.81 and a contact of 7 ms. With a damping of 5 instead of 70, e was 0.98.
    """
    return f"""<mujoco><option timestep="1e-3" integrator="RK4"/><worldbody>
    <geom name="floor" type="plane" size="5 5 1" contype="0" conaffinity="0"/>
    <body pos="0 0 1"><joint axis="0 1 0"/><inertial pos="0 0 -.9" mass=".1" diaginertia="1e-6 1e-6 1e-6"/>
    <geom name="club" size=".03" pos="0 0 -.9"/></body>
    <body pos=".2 0 .1"><freejoint/><geom name="ball" size=".02135" mass=".045"/></body></worldbody>
    <contact><pair geom1="club" geom2="ball" condim="3" solref="-200000 -{damping}"/></contact></mujoco>"""


def table_tennis():
    """Return a ball of 2.7 g above a table. The engine itself gives e = 0.967 to 0.983."""
    pair = '<pair geom1="ball" geom2="floor" solref="-1e6 -17" solimp=".98 .99 .001 .5 2"/>'
    return ball(mass=0.0027, radius=0.02, step=1e-3, pair=pair)


def second_number_is_e():
    """Return a ball whose author took the damping ratio 0.95 of solref for a restitution."""
    return ball(mass=4.19, radius=0.1, ball='solref="0.02 0.95"', floor='solref="0.02 0.95"')


def three_by_solimp():
    """Return three balls whose author expected solimp to set the restitutions 0.9, 0.6 and 0.3."""
    bodies = "".join(
        f'<body pos="{i} 0 1"><freejoint/><geom name="{name}" size=".1" mass="1" priority="1" '
        f'solref=".02 1" solimp="{d0} .95 .001 .5 2"/></body>'
        for i, (name, d0) in enumerate((("e0.9", 0.1), ("e0.6", 0.4), ("e0.3", 0.7)))
    )
    return (
        f"""<mujoco><worldbody><geom name="floor" type="plane" size="5 5 1"/>{bodies}</worldbody></mujoco>"""
    )


def cradle(solref="0.0004 1", step=2e-4):
    """Return a cradle of five balls whose author called its critically damped contacts barely damped."""
    balls = "".join(
        CRADLE_BALL.format(i=i, x=0.1 * i, mass=0.5, contact=f'solref="{solref}" condim="1"')
        for i in range(5)
    )
    return f'<mujoco><option timestep="{step}"/><worldbody>{balls}</worldbody></mujoco>'


def eight_balls():
    """Return eight balls of different masses above a floor, which alternate between two solrefs."""
    bodies = "".join(
        f'<body pos="{i} 0 1"><freejoint/><geom name="a rather long name of ball {i}" size=".1" mass="{0.1 * 1.7**i}" '
        f'solref="{("-20000 -15", "-5000 -30")[i % 2]}"/></body>'
        for i in range(8)
    )
    return f"""<mujoco><option timestep="1e-3"/><worldbody><geom name="floor" type="plane" size="9 9 1"/>{bodies}
    </worldbody></mujoco>"""


def many_geoms(n):
    """Return balls of different masses above a floor, n geoms in all, which alternate between two solrefs."""
    bodies = "".join(
        f'<body pos="{i} 0 1"><freejoint/><geom size=".1" mass="{0.1 + 0.05 * i}" '
        f'solref="{("-20000 -15", "0.01 0.3")[i % 2]}"/></body>'
        for i in range(n - 1)
    )
    return f"""<mujoco><option timestep="1e-3"/><worldbody><geom name="floor" type="plane" size="9 9 1"/>{bodies}
    </worldbody></mujoco>"""


def tennis(damping, step=2e-3):
    """Return a tennis ball on a hard court, dropped from 2.54 m.

    Its author measured e = 0.739 with a damping of 12, and e = 0.943 to 0.95 with a damping of 2.
    """
    contact = f'solref="-3500 -{damping}" solimp=".95 .99 .001 .5 2"'
    return ball(mass=0.058, radius=0.033, step=step, ball=contact, floor=contact)


def keepy_uppy():
    """Return a table tennis ball with solref (0.002, 0.5), which its author tuned for e = 0.7 to 0.8."""
    contact = 'solref="0.002 0.5"'
    return ball(mass=0.0027, radius=0.02, step=5e-3, ball=contact, floor=contact)


def golf_by_default():
    """Return the pendulum and the golf ball with MuJoCo's default contact. Its author measured e of about 0.2."""
    return golf().replace('solref="-200000 -70"', "")


def replicated_cradle(step=1e-4, condim=3):
    """Return two balls and the floor of the cradle among MuJoCo's own models.

    Its contacts are elastic, and their impedance grows with depth.
    """
    contact = f'solref="-1e8 0" solimp="0 .01 1e-3" condim="{condim}"'
    balls = "".join(
        f'<body pos="{x} 0 .04"><freejoint/>'
        f'<geom name="{name}" size=".02" density="8000" friction=".4" {contact}/></body>'
        for name, x in (("first", 0), ("second", 0.08))
    )
    return f"""<mujoco><option timestep="{step}"/><worldbody><geom name="floor" type="plane" size="4 4 .1" friction=".5"
    {contact}/>{balls}</worldbody></mujoco>"""


def braked_foot(
    contact='solimp=".015 1 .031"', losses='damping="19" frictionloss=".94"', mass=0.385, margin=0.0
):
    """Return a quadruped's foot on a slide. The slide brakes the foot as the joints of a leg do."""
    return f"""<mujoco><option cone="elliptic" impratio="100"/><worldbody><geom name="floor" type="plane" size="5 5 1"/>
    <body pos="0 0 .5"><joint type="slide" axis="0 0 1" {losses}/><geom name="foot" size=".02" mass="{mass}"
    priority="1" condim="6" friction=".8 .02 .01" margin="{margin}" {contact}/></body></worldbody></mujoco>"""


def golf_head(ball='solref="1e-4 1"', head="", pair=""):
    """Return a golf ball with its own solref above a club's head with the default solref."""
    return f"""<mujoco><option timestep="2e-4"/><worldbody><geom name="head" type="box" size=".05 .05 .02" {head}/>
    <body pos="0 0 .5"><freejoint/><geom name="ball" size=".02135" mass=".0459" {ball}/></body></worldbody>
    <contact>{pair}</contact></mujoco>"""


def probe(step=5e-5):
    """Return a ball of 0.1 kg above a table. Its author asked for the contact force and depth."""
    return f"""<mujoco><option timestep="{step}"/><worldbody><geom name="table" type="box" size=".4 .4 .05"/>
    <body pos="0 0 1"><freejoint/><geom name="ball" size=".025" mass=".1" solref=".01 .1" condim="4" priority="1"/>
    </body></worldbody></mujoco>"""


def lying(geom, floor='type="plane" size="5 5 1"', contact=""):
    """Return a body of 2 kg whose centre is just below 0.3 m, so that it lies on a floor with its top at height 0."""
    return f"""<mujoco><worldbody><geom name="floor" {floor}/><body pos="0 0 .2999"><freejoint/>
    <geom name="body" {geom} mass="2" {contact}/></body></worldbody></mujoco>"""
