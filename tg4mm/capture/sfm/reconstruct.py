"""Reconstruction of a dataset from photographs or recordings: the steps of `tg4mm sfm`, each done once.

OUT/sfm/request.json   the request, so that another one is refused
OUT/sfm/survey/        the survey of each recording, and its mean picture
OUT/sfm/frames/        frames of moving cameras' videos
OUT/sfm/images/, masks/, database.db, sparse/0/   COLMAP's own files, the last the result in its own world
OUT/…                  the dataset; scene.json, written last, marks it as complete
"""

import sys
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from tg4mm.capture.sfm import mapping
from tg4mm.capture.sfm.clip import (
    FEWEST,
    KEYS,
    SWEEP,
    SWEEP_FRAMES,
    WHOLE,
    Sources,
    extract_frames,
    find_sources,
    sharp_rows,
)
from tg4mm.capture.sfm.config import DEFAULTS, SfmConfig, Work, checked, open_request
from tg4mm.capture.sfm.dataset import video_of, write_dataset, write_flat
from tg4mm.capture.sfm.defects import check_usable, motion_of, warn_bumps, warn_clocks, warn_light
from tg4mm.capture.sfm.engine import chosen_pairs, colmap
from tg4mm.capture.sfm.kind import (
    check_enough,
    check_fits,
    check_kind,
    check_options,
    divided,
    kind_of,
    possible_kinds,
)
from tg4mm.capture.sfm.mapping import Workspace, register_frames
from tg4mm.capture.sfm.place import Placement, clock_of, placed_tracks
from tg4mm.capture.sfm.scale import baseline_scale, measured_length
from tg4mm.capture.sfm.staging import (
    StagedPicture,
    camera_shots,
    check_sizes,
    frame_shots,
    make_database,
    photograph_shots,
    stage,
    staged_name,
    sweep_shots,
)
from tg4mm.capture.sfm.survey import Survey, survey_clip
from tg4mm.core.choices import Clock, Kind
from tg4mm.core.errors import CaptureError, Tg4mmError

FEW_POINTS = 80  # in half of the pictures: with fewer, poses are bent though reprojection errors are small


@dataclass(frozen=True)
class _Job:
    """The results of the survey of all recordings."""

    work: Work
    sources: Sources
    surveys: list[Survey]  # of sources.clips
    kind: Kind
    config: SfmConfig
    threads: int
    name: str  # of the scene


def reconstruct(
    images: Path, out: Path, config: SfmConfig = DEFAULTS, threads: int = -1, name: str | None = None
) -> dict[str, Any]:
    """Find poses, sparse points and times for the input `images`, and write the folder `out` as a dataset.

    Goes on where it was stopped; where the input is refused nothing stays. threads: −1 for all cores; with 1 the
    result repeats bit for bit on one machine, with more only to the last digits. name: of the scene; None: the
    folder's. Returns what scene.json says under "sfm".
    Raises Tg4mmError (CaptureError) on bad input: damaged recordings, too few pictures, no overlap, pictures that could
    not be placed.
    """
    config = checked(config)
    sources = find_sources(images, timed=config.fps is not None)
    check_kind(sources, config.kind)
    check_options(sources, config)
    if sources.photographs is not None or sources.sweep is not None or len(sources.clips) > 1:
        colmap("tg4mm sfm")  # raises before minutes of decoding where it is missing
    work = open_request(out, sources, config.settings())
    done = work.finished()
    if done is not None:
        return done
    try:
        with work.owned.locked("makes this dataset"):
            return _made(images, work, sources, config, threads, name or out.resolve().name)
    except CaptureError:
        work.forget()
        raise


def _made(
    images: Path, work: Work, sources: Sources, config: SfmConfig, threads: int, name: str
) -> dict[str, Any]:
    surveys = [
        survey_clip(clip, work.folder / "survey", config.window, config.keep_duplicates)
        for clip in sources.clips
    ]
    kept = [clip.without(survey.repeats) for clip, survey in zip(sources.clips, surveys, strict=True)]
    sources = replace(sources, clips=type(sources.clips)(kept))
    kind, reason = kind_of(sources, surveys, config.kind)
    if (found := divided(sources, surveys, config)) is not None:
        sources, config = found.sources, found.config
        standing = work.folder / "survey" / "standing"
        surveys = [survey_clip(sources.clips[0], standing, config.window, config.keep_duplicates)]
        sources = replace(sources, clips=(sources.clips[0].without(surveys[0].repeats),))
        kind, reason = kind_of(sources, surveys, None)
        reason = f"{found}; --kind, --from or --until overrule"
    print(f"{images}: recognised as {kind}: {reason}", file=sys.stderr, flush=True)
    warn_clocks(surveys, config.fps)
    if not kind.still:
        check_usable(surveys, kind.fixed)
    if kind.fixed:
        warn_bumps(surveys)
        warn_light(surveys)
    check_fits(images, kind, surveys, config)
    job = _Job(work, sources, surveys, kind, config, threads, name)
    return _posed(job) if kind.sees_depth else _flat(job)


def _scene(job: _Job) -> dict[str, Any]:
    scene: dict[str, Any] = {"scene": job.name, "kind": job.kind.value, "background": "as photographed"}
    if job.config.readout_s:
        scene["readout_s"] = job.config.readout_s
    periods = {survey.codec_period for survey in job.surveys}
    if len(periods) == 1 and None not in periods:
        scene["codec_period"] = periods.pop()
    if len(job.surveys) == 1 and job.surveys[0].kinds:
        scene["picture_kinds"] = job.surveys[0].kinds
    return scene


def _flat(job: _Job) -> dict[str, Any]:
    if any(value is not None for value in (job.config.baseline, job.config.unit_scale_m, job.config.length)):
        raise Tg4mmError(
            "a flat capture is measured in pixels and has no scale: leave out --length, --length-file and --baseline"
        )
    clock = clock_of(job.surveys, job.config.fps)
    survey, clip = job.surveys[0], job.sources.clips[0]
    report = {"kind": job.kind.value, "asked": job.work.scene_only}
    scene = _scene(job) | {"fps": clock.fps, "sfm": report} | _video(job)
    write_flat(job.work.out, clip, survey, clock.times_s[clip.name], job.config.window, scene)
    return report


def _video(job: _Job) -> dict[str, Any]:
    """Link the one video into the dataset, with the frames left out, so that its compression can be tested."""
    clip, survey = job.sources.clips[0], job.surveys[0]
    if not clip.is_coded:
        return {}
    linked, start_s = video_of(job.work.out, clip), max(job.config.window.start_s, 0.0)
    return {"video": {"file": f"video/{linked.name}", "from_s": start_s, "repeats": list(survey.repeats)}}


def _posed(job: _Job) -> dict[str, Any]:
    colmap("tg4mm sfm")
    config, sources = job.config, job.sources
    clock = None if job.kind.still else clock_of(job.surveys, config.fps)
    taken = _pictures(job)
    model = _model(job, taken)
    placed = mapping.registered(model)
    _check_placed(job, taken, placed)
    placement = placed_tracks(job.kind, sources, taken, placed, model, clock, config.window)
    report = _report(job, model, taken, placed, placement)
    scene = _scene(job) | {"sfm": report, "unit_scale_m": config.unit_scale_m}
    if clock is not None:
        scene["fps"] = clock.fps
    if job.kind.together:
        scene["clocks"] = Clock.synchronous if config.synchronous else Clock.independent
    if config.baseline is not None:
        scene["unit_scale_m"] = baseline_scale(placement.tracks, config.baseline)
    if config.length is not None:
        measured = measured_length(config.length, taken, placed, model, placement.world)
        scene["unit_scale_m"], report["length"] = measured.unit_scale_m, measured.record()
    write_dataset(job.work.out, placement.tracks, placement.points, scene, config.test_every)
    return report


def _pictures(job: _Job) -> list[StagedPicture]:
    """All pictures that poses are found of, the sweep's last."""
    config, sources, frames = job.config, job.sources, job.work.folder / "frames"
    if sources.photographs is not None:
        return photograph_shots(sources.photographs, config.each)
    clip, survey = sources.clips[0], job.surveys[0]
    if job.kind.still:
        rows = sharp_rows(survey.sharpness, config.frames or SWEEP_FRAMES)
        return frame_shots(clip, extract_frames(clip, frames / clip.name, config.window, rows))
    if job.kind.moving:
        paths = extract_frames(clip, frames / clip.name, config.window, total=len(survey))
        taken = frame_shots(clip, paths)
    else:
        taken = camera_shots(job.surveys, config.each)
    return taken + sweep_shots(_sweep(job), survey.size, config.each)


def _sweep(job: _Job) -> tuple[Path, ...]:
    """The sweep's pictures: all of a folder, sharp ones of a video."""
    sweep, work = job.sources.sweep, job.work.folder
    if sweep is None:
        return ()
    if not sweep.is_video:
        return sweep.pictures
    window = sweep.window or WHOLE
    survey = survey_clip(sweep, work / "survey", window, job.config.keep_duplicates)
    rows = sharp_rows(survey.sharpness, job.config.frames or SWEEP_FRAMES)
    return extract_frames(sweep.without(survey.repeats), work / "frames" / SWEEP, window, rows)


def _model(job: _Job, taken: list[StagedPicture]) -> Any:
    work, config = job.work.folder, job.config
    sparse = work / "sparse" / "0"
    if sparse.is_dir():
        return mapping.saved_model(sparse)
    check_sizes(taken)
    check_enough(job.sources)
    if len(taken) < FEWEST:
        raise CaptureError(
            f"{len(taken)} pictures, at least {FEWEST} are needed; add photographs in {SWEEP}/"
        )
    masks = stage(taken, work)
    database = make_database(taken, work, config.camera_model, config.focal_px)
    workspace = Workspace(database, work / "images", masks, config.seed, job.threads)
    model = _moving_model(job, taken, workspace) if job.kind.moving else _first_model(job, taken, workspace)
    mapping.save_model(model, sparse)
    return model


def _first_model(job: _Job, taken: list[StagedPicture], workspace: Workspace) -> Any:
    """The pycolmap Reconstruction of these pictures alone, found by trying which fit."""
    names = [staged_name(shot) for shot in taken]
    frames = sum(shot.clip != SWEEP for shot in taken) if job.sources.clips else len(taken)
    ordered = job.kind.moving or (job.kind.still and bool(job.sources.clips))
    pairs = chosen_pairs(names, frames, ordered, job.config.matching)
    model = mapping.find_poses(
        workspace.database, workspace.images, workspace.masks, names, pairs, workspace.seed, job.threads
    )
    _check_placed(job, taken, mapping.registered(model), quiet=True)
    return mapping.as_pinholes(model, job.threads)


def _moving_model(job: _Job, taken: list[StagedPicture], workspace: Workspace) -> Any:
    """Return the model of sharp frames and the sweep, against which all other frames are registered."""
    frames = [shot for shot in taken if shot.clip != SWEEP]
    keys = set(sharp_rows(job.surveys[0].sharpness, job.config.frames or KEYS).tolist())
    first = [shot for shot in taken if shot.clip == SWEEP or shot.index in keys]
    folder = job.work.folder / "sparse" / "keys"
    if folder.is_dir():
        model = mapping.saved_model(folder)
    else:
        try:
            model = _first_model(job, first, workspace)
        except CaptureError as error:
            raise CaptureError(f"{error}{_why_moving(job)}") from None
        mapping.save_model(model, folder)
    names = [staged_name(shot) for shot in frames]
    register_frames(model, workspace, names, [staged_name(shot) for shot in first if shot.clip != SWEEP])
    return model


def _why_moving(job: _Job) -> str:
    """Return an explanation for an error if the kind was detected, not given."""
    if job.config.kind is not None:
        return ""
    other, why = next(kind for kind in possible_kinds(job.sources) if kind.fixed), motion_of(job.surveys[0])
    return f"; taken for a moving camera as {why}: for one that stays put use --kind {other}"


def _check_placed(job: _Job, taken: list[StagedPicture], placed: dict[str, Any], quiet: bool = False) -> None:
    """Raise CaptureError where too little was placed, else warn of what is left out."""
    needed = [staged_name(shot) for shot in taken if shot.clip != SWEEP]
    missing = mapping.check_registered(needed, placed, job.kind.fewest_placed)
    if missing and not quiet:
        text = f"{len(missing)} pictures could not be placed and are left out: {mapping.shown_names(missing)}"
        warnings.warn(text, stacklevel=2)
    typical = int(median(image.num_points3D for image in placed.values()))
    if typical < FEW_POINTS and not quiet:
        warnings.warn(
            f"a typical picture shows {typical} points of the model, too few for reliable poses (expected "
            f"{FEW_POINTS} or more): positions may be off by a tenth of the distance. More texture, larger pictures "
            "or more overlap help",
            stacklevel=2,
        )


def _report(
    job: _Job, model: Any, taken: list[StagedPicture], placed: dict[str, Any], placement: Placement
) -> dict[str, Any]:
    return {
        "kind": job.kind.value,
        "pycolmap": colmap("tg4mm sfm").__version__,
        "pictures": len(taken),
        "placed": len(placed),
        "points": len(placement.points),
        "reprojection_error_px": round(float(model.compute_mean_reprojection_error()), 4),
        "camera_model": job.config.camera_model,
        "seed": job.config.seed,
        "asked": job.work.scene_only,
    }
