"""The published files of the paper's six datasets in miniature: their true layouts, names and encodings, made anew."""

from __future__ import annotations

import io
import tarfile
import zipfile

import numpy as np
from PIL import Image

SIZE = 64, 48  # width, height
QUERY, DATABASE, OVERCAST, RAIN, NIGHT_2 = (
    "2014-11-18-13-20-12",
    "2014-12-16-18-44-24",
    "2014-12-12-10-45-15",
    "2015-10-29-12-18-17",
    "2014-11-14-16-34-33",
)
CORNER = 619_600.0, 5_734_800.0  # easting, northing in Oxford
SPEED = 8.0  # m/s of the car, to the east
BEGIN = {
    name: 1_416_316_812_000_000 + 10_000_000_000 * i
    for i, name in enumerate((QUERY, DATABASE, OVERCAST, RAIN, NIGHT_2))
}
FRAMES = 120
INTERVAL = 62_490  # microseconds between frames, 16 Hz


def scene(place, brightness=0.0):
    """An RGB image of a place: the same for the same place, but for its brightness."""
    rng = np.random.default_rng(place)
    pixels = np.kron(rng.uniform(60, 215, (6, 8, 3)), np.ones((8, 8, 1))) + brightness
    return Image.fromarray(np.clip(pixels, 0, 255).astype(np.uint8))


def encoded(image, form="JPEG"):
    stream = io.BytesIO()
    image.save(stream, form)
    return stream.getvalue()


def zipped(files):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def tarred(files, mode="w", links=()):
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode=mode) as archive:
        for name, content in files.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
        for name, target in links:
            info = tarfile.TarInfo(name)
            info.type, info.linkname = tarfile.SYMTYPE, target
            archive.addfile(info)
    return stream.getvalue()


# -- Gardens Point, AmsterTime, SVOX -----------------------------------------------------------------------------------


def gardens_point_images(n=12):
    conditions = {"day_left": 5, "day_right": 0, "night_right": -40}
    return {
        f"GardensPoint/{folder}/Image{i:03}.jpg": encoded(scene(i, brightness))
        for folder, brightness in conditions.items()
        for i in range(n)
    }


def gardens_point():
    return {"GardensPoint_Walking.zip": zipped(gardens_point_images() | {"__MACOSX/GardensPoint/._x.jpg": b"system"})}


NUMBERS = (0, 1, 2, 5, 6, 9, 40, 41, 700, 1367)


def amstertime_images():
    modes = ("RGB", "P", "RGBA", "LA")
    new = {
        f"new/{number:04}.png": encoded(
            scene(number).convert("L" if modes[i % 4] == "LA" else "RGB").convert(modes[i % 4]), "PNG"
        )
        for i, number in enumerate(NUMBERS)
    }
    old = {
        f"old/{number:04}.jpg": encoded(scene(number, -30).convert("L" if i % 2 else "RGB"))
        for i, number in enumerate(NUMBERS)
    }
    return new | old | {"description.md": b"# AmsterTime", "image_pairs.csv": b"new,old\n"}


def amstertime():
    return {"AmsterTime.zip": zipped({"AmsterTime-v1.0.zip": zipped(amstertime_images())})}


def svox_images():
    def name(place, *rest):
        return "@" + "@".join([f"{620_000 + 30 * place:.2f}", f"{5_735_000 + 3.5 * place:.3f}", *rest])

    gallery = {f"{name(i, '2012', f'pano_{i}', 'F.jpg')}": encoded(scene(i, 10)) for i in range(20)}
    queries = {f"{name(i, '1424450252183438', '.jpg')}": encoded(scene(i)) for i in range(3, 15)}
    return {
        **{f"svox/images/test/gallery/{file}": content for file, content in gallery.items()},
        **{f"svox/images/test/queries_overcast/{file}": content for file, content in queries.items()},
        **{f"svox/images/train/gallery/{file}": content for file, content in gallery.items()},
        f"svox/images/test/queries_night/{name(1, '1', '.jpg')}": encoded(scene(1, -80)),
    }


def svox():
    return {"svox.zip": zipped(svox_images())}


# -- Nordland ----------------------------------------------------------------------------------------------------------

LISTED = tuple(f"images-{number:05}.png" for number in (202, 203, 204, 205, 1810, 1811, 1812, 5479, 5480, 35582))


def nordland_frames(season, folder):
    brightness = {"summer": 0, "winter": 30, "spring": 10, "fall": -10}[season]
    every = (1, *(int(name[7:12]) for name in LISTED), 206, 1259, 33000)
    return {f"{folder}images-{n:05}.png": encoded(scene(n, brightness), "PNG") for n in sorted(every)}


def nordland():
    folders = {"summer": "summer/", "winter": "", "spring": "./spring/", "fall": "data/fall/"}
    return {
        "nordland_imageNames.txt": "".join(f"./nordland/summer/{name}\r\n" for name in LISTED).encode() + b"\r\n",
        **{f"{season}.tar.gz": tarred(nordland_frames(season, at), "w:gz") for season, at in folders.items()},
    }


# -- RobotCar ----------------------------------------------------------------------------------------------------------


def mosaic(image):
    """The raw image of a sensor whose even rows are G B G B… and odd rows R G R G…"""
    rgb = np.asarray(image)
    raw = rgb[..., 1].copy()
    raw[0::2, 1::2] = rgb[0::2, 1::2, 2]
    raw[1::2, 0::2] = rgb[1::2, 0::2, 0]
    return Image.fromarray(raw)


def times(traversal):
    return [BEGIN[traversal] + INTERVAL * i for i in range(FRAMES)]


def easting(traversal, time):
    return CORNER[0] + SPEED * (time - BEGIN[traversal]) / 1e6


def place(traversal, time):
    return int(easting(traversal, time) // 6)


def centre(traversal):
    """Names and contents of all raw images of a traversal."""
    brightness = {QUERY: 0, DATABASE: -50, OVERCAST: -10, RAIN: -20, NIGHT_2: -55}[traversal]
    raw = {p: encoded(mosaic(scene(p, brightness)), "PNG") for p in {place(traversal, t) for t in times(traversal)}}
    return {f"{traversal}/stereo/centre/{t}.png": raw[place(traversal, t)] for t in times(traversal)}


def stamps(traversal, chunks=2):
    return "".join(f"{t} {1 + i * chunks // FRAMES}\n" for i, t in enumerate(times(traversal))).encode()


def stereo_centre(traversal, chunks=2):
    images = list(centre(traversal).items())
    share = FRAMES // chunks
    return {
        f"{traversal}_stereo_centre_{c + 1:02}.tar": tarred(
            dict(images[c * share : (c + 1) * share]) | {f"{traversal}/stereo.timestamps": stamps(traversal)}
        )
        for c in range(chunks)
    }


def pose_rows(traversal, every, header):
    """Lines of a pose file, every so many microseconds, from half a second in to the last frame."""
    lines = [header]
    for t in range(BEGIN[traversal] + 500_000, times(traversal)[-1] + every, every):
        values = {"timestamp": t, "ins_status": "INS_SOLUTION_GOOD", "easting": repr(easting(traversal, t))}
        values |= {"northing": repr(CORNER[1]), "utm_zone": "30U"}
        lines.append(",".join(str(values.get(name, "0")) for name in header.split(",")))
    return lines


_REST = "down,utm_zone,velocity_north,velocity_east,velocity_down,roll,pitch,yaw"
INS = f"timestamp,ins_status,latitude,longitude,altitude,northing,easting,{_REST}"
RTK = f"timestamp,latitude,longitude,altitude,northing,easting,{_REST}"


def ins(traversal):
    return pose_rows(traversal, 20_000, INS)


def rtk(traversal):
    return pose_rows(traversal, 100_000, RTK)


def gps(traversal, lines=None):
    return {
        f"{traversal}_gps.tar": tarred(
            {f"{traversal}/gps/ins.csv": "\n".join([*(lines or ins(traversal)), ""]).encode()}
        )
    }


def rtk_zip(**lines):
    tracks = {name: rtk(name) for name in (QUERY, DATABASE, NIGHT_2)} | lines
    return {
        "rtk.zip": zipped({f"rtk/{name}/rtk.csv": "\n".join([*rows, ""]).encode() for name, rows in tracks.items()})
    }


def robotcar():
    files = rtk_zip()
    for traversal in BEGIN:
        files |= stereo_centre(traversal) | gps(traversal)
    return files


# -- St Lucia ----------------------------------------------------------------------------------------------------------

FILM, PER_FIX, METRES = 90, 6, 3.0  # frames of a film, frames for each fix of the GPS, metres between fixes


def film(n=FILM, brightness=0.0):
    """An AVI whose frame i shows the place of its GPS fix."""
    import av

    stream = io.BytesIO()
    with av.open(stream, "w", format="avi") as container:
        video = container.add_stream("mjpeg", rate=15)
        video.width, video.height, video.pix_fmt = *SIZE, "yuvj420p"
        for i in range(n):
            frame = av.VideoFrame.from_image(scene(i // PER_FIX // 2, brightness)).reformat(format="yuvj420p")
            container.mux(video.encode(frame))
        container.mux(video.encode())
    return stream.getvalue()


def gps_lines(n=FILM):
    """``latitude,longitude`` of each frame, the latitude without its sign; to the north."""
    return [f"{27.5 - METRES * (i // PER_FIX) / 110_800:.9f},153.012345" for i in range(n)]


def st_lucia_zip(traversal, lines=None, video=None):
    folder = f"{traversal}/"
    text = "\n".join(gps_lines() if lines is None else lines) + "\n"
    return zipped({f"{folder}fGPS.txt": text.encode(), f"{folder}webcam_video.avi": film() if video is None else video})


def st_lucia():
    return {
        f"{name}.zip": st_lucia_zip(name, video=film(brightness=b))
        for name, b in (("100909_0845", 0), ("180809_1545", -40))
    }


ALL = {
    "gardens_point": gardens_point,
    "amstertime": amstertime,
    "nordland": nordland,
    "robotcar": robotcar,
    "st_lucia": st_lucia,
    "svox": svox,
}
