"""The draws of convergence.sh, which describes them. Standard library only."""
import argparse
import collections
import csv
import json
import math
import os
import pathlib
import random
import resource
import shlex
import statistics
import subprocess
import sys

import model_files

# A refinement that takes longer is stopped: it counts as failed.
MAX_CPU_S = 1200
MAX_CHANGE_STDS = 1e-3
KEYPOINT_CHANGE = 1e-9  # pixels
# Flags of cameras whose intrinsics the data do not determine.
UNDETERMINED = ("weakly_determined", "held", "constant", "no_observations")


class Draw:
    """What one run is given: folders of frames, RIG and truth, and options."""

    def __init__(self, set_name, repeat, seed, args):
        self.work = args.work / set_name / str(seed)
        self.work.mkdir(parents=True, exist_ok=True)
        self.repeat = f"tests/benchmark/convergence.sh --only {seed} {repeat}"
        if args.refiner_options:
            self.repeat += f" -- {shlex.join(args.refiner_options)}"
        self.facts = {"set": set_name, "seed": seed}
        self.random = random.Random(f"{set_name} {seed}")


def draw_frames(folder, seed, args):
    """Random frames of a capture on disk."""
    set_name = "/".join(folder.parts[-2:])
    draw = Draw(set_name, shlex.quote(str(folder)), seed, args)
    names = sorted(path.name for path in folder.iterdir() if path.is_dir())
    num_frames = draw.random.randint(1, len(names))
    names = sorted(draw.random.sample(names, num_frames))
    model = draw.random.choice([""] * 3 + ["SIMPLE_RADIAL", "OPENCV", "FULL_OPENCV"])
    # Only these extrinsics are not exact.
    soft = draw.random.random() < 0.5 and set_name.startswith("robovision12")

    draw.frames = folder
    rigs = [folder.parent / name for name in ("calibration", "rig")]
    draw.rig = next((rig for rig in rigs if rig.is_dir()), None)
    if draw.rig is None:
        sys.exit(f"There is neither {rigs[0]} nor {rigs[1]}.")
    draw.truth = draw.rig
    (draw.work / "list.txt").write_text("".join(name + "\n" for name in names))
    draw.options = ["--frame_list_path", str(draw.work / "list.txt")]
    draw.options += ["--MultiFrame.camera_model", model] if model else []
    draw.options += args.soft.split() if soft else []
    draw.facts.update(camera_model=model, extrinsics="soft" if soft else "exact",
                      frames=num_frames)
    return draw


def draw_simulated(seed, args):
    """A simulated capture."""
    draw = Draw("simulated", "--draws 0", seed, args)
    rng = draw.random
    names = [name for name, _ in model_files.CAMERA_MODELS.values()]
    draw.facts.update(
        camera_model=rng.choice(names), extrinsics="exact",
        cameras=rng.randint(6, 24), frames=rng.randint(1, 8),
        points=rng.randint(150, 1000), noise=round(rng.uniform(0.2, 1.0), 2),
        outlier_share=round(rng.uniform(0.02, 0.3), 2),
        initial_focal_length_sigma=round(rng.uniform(0.0, 0.03), 4),
        initial_principal_point_sigma=round(rng.uniform(0.0, 8.0), 1),
        initial_distortion_sigma=round(rng.uniform(0.0, 0.004), 4))
    options = {"output_path": draw.work / "capture", "Simulator.seed": seed}
    for name, value in draw.facts.items():
        if name not in ("set", "seed", "extrinsics"):
            num = "num_" if name in ("cameras", "frames", "points") else ""
            options[f"Simulator.{num}{name}"] = value
    for name, value in (("render_images", 0), ("num_threads", 1), ("overwrite", 1),
                        ("quiet", 1)):
        options[f"Simulator.{name}"] = value
    command = [str(args.program), "multi_frame_simulator"]
    command += [word for name, value in options.items() for word in (f"--{name}", str(value))]
    if args.only is not None:
        print(shlex.join(command))
    subprocess.run(command, check=True)
    draw.frames = draw.work / "capture/frames"
    draw.rig = draw.work / "capture/rig"
    draw.truth = draw.work / "capture/ground_truth"
    draw.options = []
    return draw


def refine(draw, frames, rig, name, args):
    """Exit code, user CPU seconds, the first error, and the summary or None."""
    out = draw.work / name
    command = [str(args.program), "multi_frame_intrinsics_refiner",
               "--input_path", str(frames), "--extrinsics_path", str(rig),
               "--output_path", str(out), *draw.options, "--MultiFrame.num_threads", "1",
               *args.refiner_options]
    if args.only is not None:
        print(shlex.join(command), flush=True)
    log = draw.work / f"{name}.log"
    with open(log, "w", encoding="utf-8") as file:
        process = subprocess.Popen(
            command, stdout=file, stderr=file,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S,) * 2))
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    text = log.read_text(encoding="utf-8", errors="replace")
    if args.only is not None:
        print(text, flush=True)
    errors = [line for line in text.splitlines() if line.startswith("ERROR: ")]
    summary = out / "summary.json"
    error = errors[0].replace(str(out), "OUT") if errors else ""
    return (process.returncode, usage.ru_utime, error,
            json.loads(summary.read_text()) if summary.is_file() else None)


def rms(values):
    return math.sqrt(statistics.fmean(value**2 for value in values)) if values else None


def params(camera):
    return [math.inf if param is None else param for param in camera["params"]]


def judge(summary, truth):
    """Iterations and errors of one result. In standard deviations only where truth
    and result have the same camera model."""
    stages = summary["stages"]
    numbers = {
        "status": summary["result"]["status"],
        "iterations": sum(stage["iterations"] for stage in stages),
        "final_iterations": sum(stage["iterations"] for stage in stages
                                if stage["name"] == "final"),
        "last_step_stds": summary["result"].get("last_step_stds"),
        "last_focal_change": summary["result"].get("last_focal_change"),
        "focal_permille": 0.0,
    }
    stds = {"focal": [], "principal_point": []}
    for camera in summary["cameras"]:
        true_model, true_params = truth[camera["name"]]
        n = model_files.num_focal_lengths(camera["model"])
        true_n = model_files.num_focal_lengths(true_model)
        for i in range(max(n, true_n)):
            true_focal = true_params[min(i, true_n - 1)]
            error = abs(params(camera)[min(i, n - 1)] / true_focal - 1.0) * 1000.0
            if not error <= numbers["focal_permille"]:
                numbers.update(focal_permille=error, focal_camera=camera["name"])
        if camera["model"] != true_model or any(
                flag.startswith(UNDETERMINED) for flag in camera["flags"]):
            continue
        for i, std in enumerate(camera["params_std"][:n + 2]):
            if std:
                group = "focal" if i < n else "principal_point"
                stds[group].append((params(camera)[i] - true_params[i]) / std)
    numbers.update({f"{group}_stds": rms(values) for group, values in stds.items()})
    return numbers


def largest_change(summary, other):
    """Of an intrinsic parameter, in its standard deviations."""
    if summary is None or other is None:
        return math.inf
    changes = [abs(a - b) / std
               for first, second in zip(summary["cameras"], other["cameras"])
               for a, b, std in zip(params(first), params(second), first["params_std"])
               if std]
    return max(changes, default=0.0)


def run_draw(draw, args):
    facts = draw.facts
    code, user_s, error, summary = refine(draw, draw.frames, draw.rig, "result", args)
    facts.update(exit_code=code, user_s=round(user_s, 2), error=error, repeat=draw.repeat)
    if summary is not None:
        if "cameras" not in facts:
            facts["cameras"] = sum(camera["num_frames"] > 0 for camera in summary["cameras"])
        facts.update(judge(summary, model_files.read_text_cameras(draw.truth)))
    variants = {"moved": {"distance": KEYPOINT_CHANGE}, "shuffled": {"shuffle": True}}
    for name, change in variants.items() if args.perturb else ():
        folder = draw.work / f"{name}_inputs"
        rng = random.Random(f"{name} {facts['set']} {facts['seed']}")
        model_files.rewrite_models(draw.frames, folder / "frames", rng, **change)
        model_files.rewrite_models(draw.rig, folder / "rig", rng, **change)
        other_code, _, _, other = refine(draw, folder / "frames", folder / "rig", name, args)
        facts.update({f"{name}_exit_code": other_code,
                      f"{name}_stds": largest_change(summary, other)})
    return facts


def describe(facts):
    units = {"cameras": "cameras", "frames": "frames", "points": "points"}
    words = [facts["camera_model"] or "model as it is"]
    words += [f"{facts[name]} {unit}" for name, unit in units.items() if name in facts]
    words += ["soft extrinsics"] if facts["extrinsics"] == "soft" else []
    if "noise" in facts:
        words += [f"noise {facts['noise']} px", f"{100 * facts['outlier_share']:.0f} % outliers",
                  f"start {100 * facts['initial_focal_length_sigma']:.1f} % and "
                  f"{facts['initial_principal_point_sigma']} px off"]
    return ", ".join(words)


def quantile(values, share):
    return sorted(values)[max(0, math.ceil(share * len(values)) - 1)]


def number(value):
    return "-" if value is None else f"{value:.4g}"


def report(draws):
    """Prints the table of one set."""
    def values(name, of=draws):
        return [facts[name] for facts in of if facts.get(name) is not None]

    def worst(name, of=draws):
        facts = max((facts for facts in of if facts.get(name) is not None),
                    key=lambda facts: facts[name], default=None)
        return "-" if facts is None else f"{number(facts[name])} (seed {facts['seed']})"

    def row(name, text):
        print(f"  {name:<32} {text}")

    converged = [facts for facts in draws if facts["exit_code"] == 0]
    failed = [facts for facts in draws if facts["exit_code"] != 0]
    print(f"{draws[0]['set']}: {len(draws)} draws")
    row("exit code 0", f"{len(converged)} ({100 * len(converged) / len(draws):.0f} %)")
    codes = collections.Counter(facts["exit_code"] for facts in failed)
    row("other exit codes", ", ".join(f"{code}: {count}" for code, count in sorted(codes.items()))
        or "none")
    for name, title in (("iterations", "iterations, all solves"),
                        ("final_iterations", "iterations, solves `final`")):
        some = values(name)
        row(title, f"median {statistics.median(some):.0f}, 95 % {quantile(some, 0.95)}, "
            f"most {worst(name)}" if some else "-")
    row("last step, stds", f"worst {worst('last_step_stds', converged)}")
    is_simulated = draws[0]["set"] == "simulated"
    for name, title in (("focal_stds", "error of focal lengths, stds"),
                        ("principal_point_stds", "error of principal points, stds")):
        some = values(name, converged)
        if is_simulated and some:
            row(title, f"rms of a draw: median {statistics.median(some):.2f}, "
                f"worst {worst(name, converged)}")
    row("worst focal error, permille",
        f"exit code 0: {worst('focal_permille', converged)}, any: {worst('focal_permille')}")
    row("user CPU, s", f"median {statistics.median(values('user_s')):.1f}, "
        f"most {worst('user_s')}, sum {sum(values('user_s')):.0f}")
    for name, title in (("moved", f"keypoints moved by {KEYPOINT_CHANGE:g} px"),
                        ("shuffled", "files shuffled")):
        key = f"{name}_stds"
        if not values(key):
            continue
        both = [facts for facts in converged if facts[f"{name}_exit_code"] == 0]
        for text, some in ((title, draws), ("  exit code 0 both times", both)):
            above = sum(value > MAX_CHANGE_STDS for value in values(key, some))
            row(text, f"worst change, stds: {worst(key, some)}, "
                f"{above} of {len(some)} above {MAX_CHANGE_STDS:g}")
        differing = [str(facts["seed"]) for facts in draws
                     if facts[f"{name}_exit_code"] != facts["exit_code"]]
        if differing:
            row("", f"other exit code with seeds {' '.join(differing)}")
    for facts in failed:
        print(f"  exit code {facts['exit_code']}: {facts['repeat']}\n    {describe(facts)}\n"
              f"    {facts['error']}")
    print(flush=True)


def write_csv(path, draws):
    names = list(dict.fromkeys(name for facts in draws for name in facts))
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(draws)


def parse_arguments():
    words = sys.argv[1:]
    end = words.index("--") if "--" in words else len(words)
    parser = argparse.ArgumentParser(allow_abbrev=False, usage="see convergence.sh")
    parser.add_argument("--program", type=pathlib.Path)
    parser.add_argument("--work", type=pathlib.Path)
    parser.add_argument("--data", type=pathlib.Path)
    parser.add_argument("--soft")
    parser.add_argument("--keep", type=pathlib.Path)
    parser.add_argument("--draws", type=int, default=30)
    parser.add_argument("--simulated", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--perturb", action="store_true")
    parser.add_argument("--csv", type=pathlib.Path)
    parser.add_argument("folders", nargs="*", type=pathlib.Path)
    args = parser.parse_intermixed_args(words[:end])
    args.refiner_options = words[end + 1:]
    args.work = (args.keep or args.work).resolve()
    args.folders = [folder.resolve() for folder in args.folders]
    if args.simulated is None:
        args.simulated = 0 if args.folders else 60
    if args.only is not None:
        args.seed = args.only
        args.draws = min(1, args.draws)
        args.simulated = min(1, args.simulated)
    return args


def main():
    args = parse_arguments()
    folders = args.folders
    if not folders and args.draws > 0:
        folders = [args.data.resolve() / name for name in (
            "panoptic31/frames_triangulated", "panoptic31/frames_triangulated_drift2",
            "robovision12/frames_triangulated", "robovision12/frames_sfm")]
        for folder in folders:
            if not folder.is_dir():
                print(f"SKIPPED: there is no folder {folder}", file=sys.stderr)
        folders = [folder for folder in folders if folder.is_dir()]
    sets = [(lambda seed, folder=folder: draw_frames(folder, seed, args), args.draws)
            for folder in folders]
    sets.append((lambda seed: draw_simulated(seed, args), args.simulated))

    all_draws = []
    for make_draw, count in sets:
        draws = []
        for seed in range(args.seed, args.seed + count):
            facts = run_draw(make_draw(seed), args)
            draws.append(facts)
            print(f"{facts['set']} {seed}: exit code {facts['exit_code']}, "
                  f"{facts.get('iterations', '-')} iterations, {facts['user_s']} s",
                  file=sys.stderr)
            if args.csv:
                write_csv(args.csv, all_draws + draws)
        if draws:
            report(draws)
        all_draws += draws


main()
