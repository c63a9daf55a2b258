"""Is a camera that was bumped named? See bumped_cameras.sh."""

import argparse
import json
import math
import random
import shutil
import subprocess
from pathlib import Path


def simulate(program, folder, options):
    shutil.rmtree(folder, ignore_errors=True)
    arguments = [f"--Simulator.{name}={value}" for name, value in options.items()]
    subprocess.run([program, "multi_frame_simulator", "--output_path", folder,
                    "--Simulator.render_images=0", "--Simulator.quiet=1",
                    "--Simulator.num_threads=1", *arguments], check=True)


def turn_camera(images_txt, name, degrees, rng):
    """Turns one camera of RIG about an axis across its line of sight."""
    angle = math.radians(degrees) / 2
    direction = rng.uniform(0, 2 * math.pi)
    a = (math.cos(angle), math.sin(angle) * math.cos(direction),
         math.sin(angle) * math.sin(direction), 0.0)
    lines = images_txt.read_text().splitlines()
    for i, line in enumerate(lines):
        words = line.split()
        if line.startswith("#") or len(words) != 10 or words[9] != name:
            continue
        b = [float(word) for word in words[1:5]]
        t = [float(word) for word in words[5:8]]
        # The centre stays: t' = A t with R' = A R.
        x, y, z = t
        turned = rotate(a, (x, y, z))
        product = (a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
                   a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
                   a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
                   a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0])
        words[1:5] = [repr(value) for value in product]
        words[5:8] = [repr(value) for value in turned]
        lines[i] = " ".join(words)
    images_txt.write_text("\n".join(lines) + "\n")


def rotate(q, v):
    w, x, y, z = q
    tx = 2 * (y * v[2] - z * v[1])
    ty = 2 * (z * v[0] - x * v[2])
    tz = 2 * (x * v[1] - y * v[0])
    return (v[0] + w * tx + y * tz - z * ty,
            v[1] + w * ty + z * tx - x * tz,
            v[2] + w * tz + x * ty - y * tx)


def refine(program, frames, rig, output):
    """Names of the flagged cameras by flag; None where there is no result."""
    shutil.rmtree(output, ignore_errors=True)
    subprocess.run([program, "multi_frame_intrinsics_refiner", "--input_path", frames,
                    "--extrinsics_path", rig, "--output_path", output,
                    "--MultiFrame.num_threads=1", "--MultiFrame.quiet=1"],
                   stderr=subprocess.DEVNULL, check=False)
    summary = output / "summary.json"
    if not summary.exists():
        return None
    cameras = json.loads(summary.read_text())["cameras"]
    return {flag: [camera["name"] for camera in cameras if flag in camera["flags"]]
            for flag in ("unusual_drift", "moved", "contradicts_extrinsics")}


def remove_binary_rig(capture):
    for path in (capture / "rig").glob("*.bin"):
        path.unlink()


def bumped(args):
    print(f"{'cameras':>8} {'degrees':>8} {'runs':>5} {'drift':>6} {'moved':>6} "
          f"{'contradicts':>12} {'none':>5} {'others':>7}")
    for num_cameras in (8, 16, 38):
        for degrees in (0.2, 0.5, 2.0):
            count = dict.fromkeys(("unusual_drift", "moved", "contradicts_extrinsics",
                                   "none", "others"), 0)
            for seed in range(args.seeds):
                rng = random.Random(f"{num_cameras} {degrees} {seed}")
                capture = args.work / "capture"
                simulate(args.program, capture, {"num_cameras": num_cameras, "num_points": 600,
                                                 "seed": seed})
                remove_binary_rig(capture)
                name = f"cam{rng.randrange(num_cameras):02d}"
                turn_camera(capture / "rig/images.txt", f"{name}.png", degrees, rng)
                flags = refine(args.program, capture / "frames", capture / "rig",
                               args.work / "result") or {}
                for flag, names in flags.items():
                    count[flag] += name in names
                flagged = {flagged_name for names in flags.values() for flagged_name in names}
                count["none"] += name not in flagged
                count["others"] += len(flagged - {name})
            print(f"{num_cameras:8} {degrees:8} {args.seeds:5} {count['unusual_drift']:6} "
                  f"{count['moved']:6} {count['contradicts_extrinsics']:12} {count['none']:5} "
                  f"{count['others']:7}", flush=True)


def healthy(args):
    alarms = []
    for seed in range(args.healthy):
        rng = random.Random(f"healthy {seed}")
        # Large arrays have more cameras to be wrong about, and more that see little.
        num_cameras = rng.randint(6, 38) if seed % 5 else rng.randint(39, 160)
        options = {"num_cameras": num_cameras, "num_frames": rng.randint(1, 4),
                   "num_points": rng.randint(150, 600), "noise": rng.uniform(0.2, 1.0),
                   "outlier_share": rng.uniform(0.02, 0.3), "seed": seed,
                   "initial_focal_length_sigma": rng.uniform(0.002, 0.03),
                   "initial_principal_point_sigma": rng.uniform(1.0, 8.0)}
        capture = args.work / "capture"
        simulate(args.program, capture, options)
        flags = refine(args.program, capture / "frames", capture / "rig", args.work / "result")
        if flags is None or any(flags.values()):
            alarms.append(f"  seed {seed}: {flags} {options}")
    print(f"false alarms: {len(alarms)} of {args.healthy} healthy captures", *alarms, sep="\n")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--healthy", type=int, default=200)
    args = parser.parse_args()
    bumped(args)
    healthy(args)


if __name__ == "__main__":
    main()
