"""Grains falling into a box in PhysX as the package ovphysx runs it, on a graphics card or a processor.

    python tests/benchmarks/ovphysx_drop.py SCENE.usda OUT.npz --device gpu [--steps 3000] [--from OTHER.npz]

Scenes are packing_gpu.py's. Written are ``pose`` (n, 7: position, quaternion x y z w) and ``velocity`` (n, 6)
at the end, ``wall_s`` and ``speed`` (median) of every hundred steps, ``still`` (share of the bodies that were
still for 3 s, as the paper's criterion has it) and ``load_s``. With ``--from`` bodies begin where another run
left them.
"""

import argparse
import time

import numpy as np
from ovphysx import PhysX, PhysXConfig
from ovphysx.types import TensorType

WINDOW = 100
SLEEP_SPEED, SLEEP_S = 0.01, 3.0


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("scene")
    options.add_argument("out")
    options.add_argument("--device", choices=("gpu", "cpu"), required=True)
    options.add_argument("--threads", type=int, default=0, help="workers beside the calling thread")
    options.add_argument("--dt", type=float, default=0.01, help="that of the scene")
    options.add_argument("--steps", type=int, default=3000)
    options.add_argument("--from", dest="state")
    given = options.parse_args()

    config = PhysXConfig(
        num_threads=given.threads,
        disable_contact_processing=True,
        # PhysX's own workers: those of the package wait by spinning
        carbonite_overrides={"/physics/physxDispatcher": True, "/physics/updateToUsd": False}
        | ({"/physics/suppressReadback": True} if given.device == "gpu" else {}),
    )
    begin = time.perf_counter()
    system = PhysX(config=config, device=given.device)
    system.add_usd(given.scene)
    system.wait_all()
    if given.device == "gpu":
        import torch

        system.warmup_gpu()

    def bind(kind, width):
        binding = system.create_tensor_binding(pattern="/World/b*", tensor_type=kind)
        n = binding.shape[0]
        if given.device == "gpu":
            buffer = torch.zeros((n, width), dtype=torch.float32, device="cuda")
            return binding, buffer, lambda: buffer.cpu().numpy().copy()
        buffer = np.zeros((n, width), np.float32)
        return binding, buffer, lambda: buffer.copy()

    def put(bound, values):
        binding, buffer, _ = bound
        buffer[:] = torch.as_tensor(values) if given.device == "gpu" else values
        binding.write(buffer)

    def get(bound):
        binding, buffer, value = bound
        binding.read(buffer)
        return value()

    pose, velocity = bind(TensorType.RIGID_BODY_POSE, 7), bind(TensorType.RIGID_BODY_VELOCITY, 6)
    # the order of a binding is its own; bodies are named by their numbers
    order = np.argsort([int(path.rsplit("b", 1)[1]) for path in pose[0].prim_paths])
    if given.state:
        with np.load(given.state) as state:
            back = np.argsort(order)
            put(pose, state["pose"][back])
            put(velocity, state["velocity"][back])
    load_s = time.perf_counter() - begin

    long_enough = round(SLEEP_S / given.dt / WINDOW)
    wall, speed, still = [], [], np.zeros(len(order), int)
    before = get(pose)[:, :3]
    for k in range(given.steps // WINDOW):
        begin = time.perf_counter()
        system.step_n_sync(WINDOW, given.dt, k * WINDOW * given.dt)
        wall.append(time.perf_counter() - begin)
        now = get(pose)[:, :3]
        moved = np.linalg.norm(now - before, axis=1) / (WINDOW * given.dt)
        slow = moved < SLEEP_SPEED
        # a grain that has once been still so long counts as settled
        still = np.where(still >= long_enough, still, np.where(slow, still + 1, 0))
        speed.append(np.median(np.linalg.norm(get(velocity)[:, :3], axis=1)))
        before = now
    np.savez(
        given.out,
        pose=get(pose)[order],
        velocity=get(velocity)[order],
        wall_s=wall,
        speed=speed,
        still=(still >= long_enough).mean(),
        load_s=load_s,
    )
    took = f"{given.steps} steps in {sum(wall):.2f} s, last {1e3 * wall[-1] / WINDOW:.2f} ms a step"
    settled = f"{(still >= long_enough).mean():.3f} still, median speed {speed[-1]:.4f}"
    print(
        f"{given.scene}, {given.device}: {len(order)} bodies in {load_s:.1f} s, {took}, {settled}", flush=True
    )


if __name__ == "__main__":
    main()
