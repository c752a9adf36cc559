"""A disc that rattles without friction in a free ring, or in a rigid circle, for many steps: does anything drift?

    ./run python3 benchmarks/rattling_disc.py --steps 10000
    ./run python3 benchmarks/rattling_disc.py --steps 10000 --rigid

Both bodies lose energy of their flight to vibrations and, with each impact, to the nodes' mass (the ledger's impact_loss).
Rows are printed every tenth of the way: largest energy so far over that of the start, drifts of momentum and angular
momentum as shares of the bodies' own, largest penetration as a share of a facet.
"""

import argparse

from collisions import Body, Collision, Round, RoundBodies, obstacles, watch_steps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--steps", type=int, default=10000, help="(%(default)s)")
    add("--step", type=float, default=1e-3, help="Δt in s (%(default)s)")
    add("--size", type=float, default=0.05, help="of the elements in m (%(default)s)")
    add("--friction", type=float, default=0.0, help="(%(default)s)")
    add("--rigid", action="store_true", help="a rigid circle in place of the ring")
    args = parser.parse_args()
    disc = Body(Round(radius=0.1, size=args.size), 1e6, (1.5, 1.0))
    ring = Body(Round(radius=0.18, bore=0.14, size=args.size), 1e6, (-0.5, -0.4), touches=RoundBodies.bore(0))
    if args.rigid:
        obstacle = obstacles.RigidSphere([0.0, 0.0], 0.14, inside=True)
        scene = Collision((disc,), args.step, args.friction, obstacle=obstacle)
    else:
        scene = Collision((disc, ring), args.step, args.friction)
    print("| steps | E/E₀ − 1, largest | E/E₀ now | impact loss / E₀ | friction / E₀ | momentum | angular momentum "
          "| penetration | mean gap | ledger's defect | iterations | rejected | CPU s |")  # fmt: skip
    print("|" + "---|" * 13)
    for n, seen in enumerate(watch_steps(scene, args.steps * args.step, args.size, free=not args.rigid), start=1):
        if n % max(1, args.steps // 10) == 0 or seen.failure:
            print(
                f"| {n} | {seen.above:.1e} | {scene.energy / seen.energy:.4f} | {seen.loss / seen.energy:.4f} "
                f"| {seen.friction / seen.energy:.4f} | {seen.momentum:.0e} | {seen.spin:.0e} | {seen.deepest:.4f} "
                f"| {seen.mean_gap:.1e} | {seen.defect:.0e} | {seen.iterations} | {seen.rejected} | {seen.seconds:.0f} |",
                flush=True,
            )
    if seen.failure:
        print(seen.failure)


if __name__ == "__main__":
    main()
