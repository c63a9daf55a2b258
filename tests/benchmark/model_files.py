"""COLMAP models as files: reads cameras, and rewrites models with keypoints moved
and records shuffled. Binary and text; standard library only."""
import math
import pathlib
import struct

# Model id: name, number of parameters.
CAMERA_MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5), 4: ("OPENCV", 8), 5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12)}


def num_focal_lengths(model):
    return 1 if model.startswith(("SIMPLE_", "RADIAL")) else 2


def read_text_cameras(folder):
    """Of each image, by its name without suffix: camera model and parameters."""
    def lines(name):
        return [line.split() for line in (folder / name).read_text().splitlines()
                if line.strip() and not line.startswith("#")]

    cameras = {words[0]: (words[1], [float(word) for word in words[4:]])
               for words in lines("cameras.txt")}
    # Lines of keypoints have a multiple of three words, and no name at the end.
    return {pathlib.PurePath(words[9]).stem: cameras[words[8]]
            for words in lines("images.txt") if len(words) == 10}


def rewrite_models(source, target, rng, distance=0.0, shuffle=False):
    """Copies all models below the folder `source`; keypoints are moved by
    `distance` in random directions."""
    def move(xy):
        angle = rng.uniform(0.0, 2.0 * math.pi)
        return (xy[0] + distance * math.cos(angle), xy[1] + distance * math.sin(angle))

    def reorder(records):
        if shuffle:
            rng.shuffle(records)
        return records

    rewriters = {"cameras.bin": _rewrite_binary_cameras, "cameras.txt": _rewrite_text_cameras,
                 "images.bin": _rewrite_binary_images, "images.txt": _rewrite_text_images,
                 "points3D.bin": _rewrite_binary_points, "points3D.txt": _rewrite_text_points}
    for path in sorted(source.rglob("*")):
        if path.name in rewriters:
            copy = target / path.relative_to(source)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_bytes(rewriters[path.name](path.read_bytes(), move, reorder))


def _join(records, reorder):
    return struct.pack("<Q", len(records)) + b"".join(reorder(records))


def _rewrite_binary_cameras(data, _, reorder):
    records, begin = [], 8
    while begin < len(data):
        (model,) = struct.unpack_from("<i", data, begin + 4)
        end = begin + 24 + 8 * CAMERA_MODELS[model][1]
        records.append(data[begin:end])
        begin = end
    return _join(records, reorder)


def _rewrite_binary_images(data, move, reorder):
    records, begin = [], 8
    while begin < len(data):
        keypoints = data.index(b"\0", begin + 64) + 9
        (count,) = struct.unpack_from("<Q", data, keypoints - 8)
        end = keypoints + 24 * count
        moved = (struct.pack("<ddq", *move(keypoint), keypoint[2])
                 for keypoint in struct.iter_unpack("<ddq", data[keypoints:end]))
        records.append(data[begin:keypoints] + b"".join(moved))
        begin = end
    return _join(records, reorder)


def _rewrite_binary_points(data, _, reorder):
    records, begin = [], 8
    while begin < len(data):
        track = begin + 51
        (length,) = struct.unpack_from("<Q", data, track - 8)
        end = track + 8 * length
        elements = [data[i:i + 8] for i in range(track, end, 8)]
        records.append(data[begin:track] + b"".join(reorder(elements)))
        begin = end
    return _join(records, reorder)


def _text_records(data):
    return [line for line in data.decode().splitlines() if not line.startswith("#")]


def _text(records, reorder):
    return "".join(record + "\n" for record in reorder(records)).encode()


def _rewrite_text_cameras(data, _, reorder):
    return _text(_text_records(data), reorder)


def _rewrite_text_images(data, move, reorder):
    lines, records = _text_records(data), []
    for image, keypoints in zip(lines[0::2], lines[1::2]):
        words = keypoints.split()
        moved = [f"{x!r} {y!r} {point}" for (x, y), point in
                 ((move((float(x), float(y))), point) for x, y, point in
                  zip(words[0::3], words[1::3], words[2::3]))]
        records.append(image + "\n" + " ".join(moved))
    return _text(records, reorder)


def _rewrite_text_points(data, _, reorder):
    records = []
    for line in _text_records(data):
        words = line.split()
        track = reorder(list(zip(words[8::2], words[9::2])))
        records.append(" ".join(words[:8] + [word for element in track for word in element]))
    return _text(records, reorder)
