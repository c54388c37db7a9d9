#!/usr/bin/python3
"""The smallest correct continuum side: a flat plate of 2 x 2 facets whose nodes are masses without ground under them.

The plate presses down on nothing but the grains that its InitialStress promises: it starts from balance (its own baseline force
is minus the grains' force at t_0), gets a small downward velocity, and then moves by the grains' forces alone. With springs as
grains (peer_grains.py) each node swings; the run prints the motion and its frequency's error, and fails if it is wrong.
The contract is protocol/coupling.proto; read that first, then this.

    peer_continuum.py PORT [--host 127.0.0.1] [--steps 200]
"""
import argparse
import math
import socket
import sys

from wire_peer import Wire, hash_of, wire

MASS = 100.0        # of a node [kg]
PRESSURE = 10e3     # of the grains on the plate at t_0 [Pa]
SIDE = 0.1          # of a facet [m]
KICK = -0.01        # velocity of every node at t_(-1/2) [m/s]


def run(peer, steps, origin=(0.0, 0.0, 0.0)):
    # Nodes row by row; each facet counter-clockwise seen from above, so that its normal +z points into the grains.
    x = [[origin[0] + SIDE * i, origin[1] + SIDE * j, origin[2]] for j in range(3) for i in range(3)]
    facets = [[a, a + 1, a + 4, a + 3] for a in (0, 1, 3, 4)]

    peer.send(wire.Hello(major=1, minor=0, role=wire.CONTINUUM, solver="peer_continuum.py", solver_version="1"))
    hello = peer.expect(wire.Hello)
    print(f"connected to {hello.solver} {hello.solver_version}")

    # Step 1. Grains above push down: the traction on the continuum is negative z.
    peer.send(wire.InitialStress(
        nodes=[c for node in x for c in node], facets=[a for facet in facets for a in facet], ring=[-1] * 4,
        traction=[0.0, 0.0, -PRESSURE] * 4, stress=[0.0, 0.0, -PRESSURE, 0.0, 0.0, 0.0] * 4,
        gravity=[0.0, 0.0, -9.81], bulk_density=1630.0))
    peer.expect(wire.Balance)                                                            # step 2
    peer.send(wire.ContinuumExcavated(position_hash=hash_of(x)))                         # step 3
    excavated = peer.expect(wire.GrainsExcavated)
    if excavated.position_hash not in (0, hash_of(x)):
        peer.abort(3, "position hash of x(0) differs")
    # What holds the plate against the grains at t_0, for good: the ground that this peer does not model.
    baseline = [-f for f in excavated.nodal_force]

    # The clock is the continuum's. A node of mass m on a spring k swings at omega = sqrt(k/m); leap-frog needs
    # dt < 2/omega, and a twentieth of that is smooth. 1e-3 s serves grains that do not tell their stiffness.
    stiffness = max(excavated.node_stiffness, default=0.0)
    # The grains have a limit of their own (0: none), and give up on whoever exceeds it.
    time_step = 0.1 * math.sqrt(MASS / stiffness) if stiffness > 0 else 1e-3
    if excavated.stable_step > 0:
        time_step = min(time_step, 0.5 * excavated.stable_step)
    velocity = [[0.0, 0.0, KICK] for _ in x]
    height = []  # of the middle node at t_n
    for step in range(steps):
        # v(n-1/2) goes out, x(n) is where the nodes are now; dt is what leads to x(n+1).
        peer.send(wire.Velocities(step=step, stage=wire.PENETRATE, time_step=time_step,
                                  velocity=[c for node in velocity for c in node],
                                  position_hash=hash_of(x) if step % 10 == 0 else 0))
        forces = peer.expect(wire.Forces)
        if forces.step != step or len(forces.force) != 3 * len(x):
            peer.abort(3, f"Forces({forces.step}) with {len(forces.force)} numbers where step {step} is due")
        if 0 < forces.stable_step < time_step:
            peer.abort(4, f"the grains' limit {forces.stable_step} s fell below the step {time_step} s, which this peer keeps")
        height.append(x[4][2])
        for node in range(len(x)):
            for i in range(3):
                velocity[node][i] += (forces.force[3 * node + i] + baseline[3 * node + i]) / MASS * time_step
                x[node][i] += velocity[node][i] * time_step
    peer.send(wire.Finish(step=steps, text="all steps done"))
    peer.expect(wire.Finish)
    return height, time_step, stiffness


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("port", type=int)
    options.add_argument("--host", default="127.0.0.1")
    options.add_argument("--steps", type=int, default=200)
    arguments = options.parse_args()
    with socket.create_connection((arguments.host, arguments.port), timeout=30) as connection:
        height, time_step, stiffness = run(Wire(connection), arguments.steps)
    print(f"{len(height)} steps of {time_step:.3e} s, height from {min(height):.6e} to {max(height):.6e} m")
    if stiffness > 0:
        # Leap-frog on a linear spring, x(n+1) - 2 x(n) + x(n-1) = -(omega dt)^2 x(n), x(0) = 0: x(n) = A sin(n phi) with
        # sin(phi/2) = omega dt/2, and x(1) = v(1/2) dt = A sin(phi).
        phi = 2 * math.asin(0.5 * math.sqrt(stiffness / MASS) * time_step)
        exact = [KICK * time_step * math.sin(n * phi) / math.sin(phi) for n in range(len(height))]
        error = max(abs(a - b) for a, b in zip(height, exact)) / max(abs(b) for b in exact)
        print(f"largest error against the discrete solution: {error:.1e} of the amplitude")
        sys.exit(0 if error < 1e-9 else 4)


if __name__ == "__main__":
    main()
