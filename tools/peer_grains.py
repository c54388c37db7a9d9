#!/usr/bin/python3
"""The smallest correct grains side: a linear spring under every interface node.

It listens, prints its port, and answers each Velocities(n) by the forces of the grains ON the continuum at t_n: what the ground
carried before (handed over as tractions, lumped to the nodes by area) less a spring times the node's motion along its normal.
The contract is protocol/coupling.proto; read that first, then this from the bottom up.

    peer_grains.py [--port 0] [--stiffness 1e6]          # python3 with python3-protobuf, and protoc
"""
import argparse
import socket

from wire_peer import Wire, hash_of, wire


def area_vectors(x, facets):
    """Per facet, half the cross product of its diagonals: its area times the normal into the grains [m2]."""
    vectors = []
    for a, b, c, d in facets:
        p = [x[c][i] - x[a][i] for i in range(3)]
        q = [x[d][i] - x[b][i] for i in range(3)]
        vectors.append([0.5 * (p[1] * q[2] - p[2] * q[1]), 0.5 * (p[2] * q[0] - p[0] * q[2]), 0.5 * (p[0] * q[1] - p[1] * q[0])])
    return vectors


def triples(numbers):
    return [list(numbers[i:i + 3]) for i in range(0, len(numbers), 3)]


def run(peer, stiffness):
    peer.expect(wire.Hello)
    peer.send(wire.Hello(major=1, minor=0, role=wire.GRAINS, solver="peer_grains.py", solver_version="1"))

    # Step 1: the interface. Its node order is fixed from here on.
    initial = peer.expect(wire.InitialStress)
    x = triples(initial.nodes)
    facets = [initial.facets[i:i + 4] for i in range(0, len(initial.facets), 4)]
    nodes = len(x)
    base = [[0.0] * 3 for _ in x]    # what the ground carried, a quarter of each facet's force to each corner [N]
    normal = [[0.0] * 3 for _ in x]  # unit normal into the grains
    for corners, area, traction in zip(facets, area_vectors(x, facets), triples(initial.traction)):
        size = sum(a * a for a in area) ** 0.5
        for node in corners:
            for i in range(3):
                base[node][i] += 0.25 * size * traction[i]
                normal[node][i] += area[i]
    for n in normal:
        length = sum(a * a for a in n) ** 0.5 or 1.0
        n[:] = [a / length for a in n]

    # Step 2: springs are balanced as they stand.
    peer.send(wire.Balance(traction=initial.traction, porosity=0.4, particles=nodes, contacts=nodes))

    # Step 3: the zones are gone; both prove that they hold the same positions.
    excavated = peer.expect(wire.ContinuumExcavated)
    if excavated.position_hash not in (0, hash_of(x)):
        peer.abort(3, "position hash of x(0) differs")
    peer.send(wire.GrainsExcavated(offset=[0.0] * (3 * nodes), node_stiffness=[stiffness] * nodes,
                                   nodal_force=[f for node in base for f in node], position_hash=hash_of(x)))

    # Steps 5 to 7, until the continuum says Finish.
    lift = [0.0] * nodes  # motion of each node along its normal since t_0 [m]
    time_step, step = 0.0, 0
    while True:
        message = peer.expect(wire.Velocities, wire.Finish)
        if isinstance(message, wire.Finish):
            peer.send(wire.Finish(step=message.step, text="agreed"))
            return
        if message.step != step or len(message.velocity) != 3 * nodes:
            peer.abort(3, f"Velocities({message.step}) with {len(message.velocity)} numbers where step {step} is due")
        # x(n) = x(n-1) + v(n-1/2) dt, with the dt that came with n-1: zero before the first exchange.
        velocity = triples(message.velocity)
        for node in range(nodes):
            for i in range(3):
                x[node][i] += velocity[node][i] * time_step
            lift[node] += sum(velocity[node][i] * normal[node][i] for i in range(3)) * time_step
        if message.position_hash not in (0, hash_of(x)):
            peer.abort(3, f"position hash of x({step}) differs")
        force = [base[node][i] - stiffness * lift[node] * normal[node][i] for node in range(nodes) for i in range(3)]
        peer.send(wire.Forces(step=step, force=force, particle_force=[-sum(force[i::3]) for i in range(3)]))
        time_step, step = message.time_step, step + 1


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--port", type=int, default=0, help="0 takes a free one")
    options.add_argument("--stiffness", type=float, default=1e6, help="of each node's spring [N/m]")
    arguments = options.parse_args()
    with socket.create_server(("127.0.0.1", arguments.port)) as listener:
        print(f"listening on 127.0.0.1:{listener.getsockname()[1]}", flush=True)
        connection, _ = listener.accept()
    with connection:
        run(Wire(connection), arguments.stiffness)


if __name__ == "__main__":
    main()
