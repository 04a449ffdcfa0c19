"""What ``bicycle-env COMMAND --help`` says beside its words: descriptions and examples."""

from __future__ import annotations

from bicycle_env.installation import install_line

REPORT = f"""\
Everything that theory says about one car at one speed: parameters, stability, steady and frequency response to front
and rear steering, the limit of grip, and the states from which the car can be saved at all.

With --out DIR: a page DIR/report.html that needs no other file, and its pictures as PNG files beside it (needs
{install_line("analysis")}). With --json: the numbers for machines, on standard output. Without either: the
numbers as tables.
"""
REPORT_EXAMPLES = """\
examples:
  bicycle-env report --out report-oversteer
  bicycle-env report --vehicle civic --speed 40 --out report-civic
  bicycle-env report --vehicle oversteer --speed-ratio 1.2 --tire magic_formula --friction 0.3 --out icy
  bicycle-env report --vehicle my_car.toml --speed 35
  bicycle-env report --vehicle parameters_vehicle2.yaml --tire my_tire.tir --out report-mine
  bicycle-env report --vehicle neutral --json | jq .figures.damping_ratio

a car of one's own, my_car.toml (or the same names in my_car.json):
  mass = 1500.0                          # kg
  yaw_inertia = 2500.0                   # kg m^2
  cg_to_front = 1.4                      # centre of mass to front axle, m
  cg_to_rear = 1.3                       # m
  front_cornering_stiffness = 110e3      # N/rad, both front tires together
  rear_cornering_stiffness = 90e3        # N/rad
  source = "where the numbers come from" # optional, as are half-tracks, overhangs and body_width in m

JSON: {"vehicle", "speed", "tire", "friction", "figures", "units", "absent"}. SI units, angles in rad. A figure is null
where it is infinite or undefined, and "absent" says why (a car that does not oversteer has no critical speed).
"""
PLAY = f"""\
Shows policies at work: in a window, or in a file. Several drive from the same start, one above the other.

A policy is a controller's name (lqr, preview+sano, zero for nobody, ...), "pretrained", MODULE:NAME of one's own, a
folder of a trained policy, a .json file of tuned parameters, or "human": the left and right arrow keys (or A and D, or
the stick of a gamepad) steer the front wheels. In the window Esc leaves, and the space bar goes on to the next start.

FILE.gif needs {install_line("render")}, as the window does;
FILE.mp4 {install_line("video")} too. FILE.npz holds states, actions and rewards as arrays with their names.
"""
PLAY_EXAMPLES = """\
examples:
  bicycle-env play --env-id BicycleStab-v0 --policy lqr
  bicycle-env play --env-id BicycleActiveSteer-v0 --policy zero rear-switched pretrained --seed 3 --out run.gif
  bicycle-env play --env-id BicycleEvade-v0 --level hard --policy pretrained --starts 5
  bicycle-env play --env-id BicycleDoubleLaneChange-v0 --policy human --rear yaw-rate
  bicycle-env play --env-id BicycleStab-v0 --policy lqr --starts 20 --out runs.npz
"""
EXPORT = """\
The laws of this package written out for other languages, with test vectors and a program that checks them.

The car (default): one RK4 substep of the single-track model with its tires and actuators is a function of state,
command, car and timestep, and a control step loops over it. All numbers of the car are arguments, so the same functions
serve for other cars, speeds and roads; the tire law, the geometry and whether tires relax are in the code.

A task (--env-id): start, step and observe, so that whole episodes run in the other language.

A policy (--policy): LQR as a matrix, a network as arrays, in single precision; the test prints how far it is from
Python's.

  c       C99. Equal to the laws in plain Python to the bit; with --fma to the environments.
  js      a JavaScript module for browsers and node. Equal to the laws in plain Python to the bit.
  casadi  the car as x' = f(x, u), a casadi.Function in a file, for acados and do-mpc.
  fmu     the car as an FMU 2.0 for co-simulation (Simulink, OpenModelica, FMPy), with a Linux binary if gcc is here.
"""
EXPORT_EXAMPLES = """\
examples:
  bicycle-env export --vehicle oversteer --tire fiala --format c --out car
  cd car && gcc -std=c99 -Wall -ffp-contract=off bicycle_plant.c bicycle_plant_test.c -o t -lm && ./t
  bicycle-env export --vehicle my_car.toml --speed 35 --tire magic_formula --relaxation-length 0.5 --format js --out car
  bicycle-env export --front-actuator angle_limit=0.5,rate_limit=inf --format casadi --out car
  bicycle-env export --env-id BicycleEvade-v0 --level hard --format js --out evade
  bicycle-env export --policy pretrained --env-id BicycleStab-v0 --format c --out policy
  bicycle-env export --policy lqr --vehicle oversteer --speed-ratio 1.3 --format c --out policy

docs/export.md says how to use what is written.
"""
EXPLORE = """\
A page in the browser: a car near its stability limit, its eigenvalues, its phase plane, and two drivers side by side
from the same start. It computes in the browser, with the package's own laws; nothing is asked of another machine.
"""
EXPLORE_EXAMPLES = """\
examples:
  bicycle-env explore
  bicycle-env explore --port 0 --no-browser
  bicycle-env explore --out site     # the same page as files, for any web server

docs/explore.md says what is on it.
"""
