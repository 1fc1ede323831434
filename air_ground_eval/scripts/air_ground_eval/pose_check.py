"""Whether reference poses turn as the images do: poses of a marker body, of a mirrored world or of another clock make an IMU that lies."""
from dataclasses import dataclass

import cv2
import numpy as np

from . import geometry, registration

PAIRS, FEWEST = 20, 6       # tried; usable ones that a verdict rests on
TURN = np.radians(6.0)      # the second image of a pair is the first one turned by so much ...
LEAST_TURN = np.radians(3.0)  # ... and the pair counts if poses or images say so much
MOST_TURN = np.radians(45)    # between images that share features; more is a pose upside down, as planes give some
LONGEST = 3.0               # [s] between the images of a pair
DEPTH_AWAY = 0.02           # [s] between an image and its depth
MOST_DISAGREEMENT = 0.4     # of the turn, median; 7-Scenes with the depth camera's intrinsics for colour: 0.2
INLIERS, INLIER_RATIO = 30, 0.4
REPROJECTION = 3.0          # [px]


@dataclass
class Agreement:
    pairs: int           # usable
    turn: float          # median [rad]
    difference: float    # median of the rotation between the poses' turn and the images' [rad]
    ratio: float         # median of difference to turn
    rotation: np.ndarray  # (4,) quaternion of a camera in the poses' frames with which they would agree; None if none does

    def refused(self):
        return self.pairs >= FEWEST and self.ratio > MOST_DISAGREEMENT


def choose_pairs(frames, depth, poses, valid):
    """Up to PAIRS (index, index, depth Frame): images with a pose and a depth, and a later one that has turned, at most LONGEST [s] on."""
    stamps = np.array([frame.stamp for frame in frames])
    depth_stamps = np.array([frame.stamp for frame in depth])
    nearest = np.array([np.argmin(np.abs(depth_stamps - stamp)) for stamp in stamps])
    starts = np.flatnonzero(valid & (np.abs(depth_stamps[nearest] - stamps) <= DEPTH_AWAY))
    pairs = []
    for i in starts[np.unique(np.linspace(0, len(starts) - 1, PAIRS).astype(int))] if len(starts) else []:
        later = np.flatnonzero(valid & (stamps > stamps[i]) & (stamps <= stamps[i] + LONGEST))
        if not len(later):
            continue
        turns = geometry.rotation_angle(np.swapaxes(poses[later, :3, :3], 1, 2) @ poses[i, :3, :3])
        far = np.flatnonzero(turns >= TURN)
        if len(far):
            j = later[far[0]]
        elif turns.max() >= LEAST_TURN:
            j = later[np.argmax(turns)]
        else:  # poses that do not turn may be wrong, too
            j = later[len(later) // 3]
        pairs.append((i, j, depth[nearest[i]]))
    return pairs


class Images:
    """Features of a recording's images, in undistorted coordinates of its camera."""

    def __init__(self, recording):
        self.recording = recording
        camera = recording.camera
        self.K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        self.orb = cv2.ORB_create(1500)
        self.matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)

    def features(self, frame):
        """(pixels (n, 2), their undistorted coordinates (n, 2) at z = 1, descriptors), None where there are few."""
        image = frame.read()
        keypoints, descriptors = self.orb.detectAndCompute(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None)
        if len(keypoints) < INLIERS:
            return None
        pixels = np.array([k.pt for k in keypoints])
        return pixels, cv2.undistortPoints(pixels[:, None], self.K, np.array(self.recording.camera.distortion))[:, 0], descriptors

    def turn(self, first, depth, second):
        """Rotation of the first image's camera in the second's (3, 3), from the first one's depth; None where the images do not tell."""
        a, b = self.features(first), self.features(second)
        if a is None or b is None:
            return None
        matches = self.matcher.match(a[2], b[2])
        metres = registration.depth_in_millimetres(self.recording, depth.path) * 1e-3
        u, v = np.rint(a[0]).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < metres.shape[1]) & (v < metres.shape[0])
        z = np.where(inside, metres[np.where(inside, v, 0), np.where(inside, u, 0)], 0)
        matches = [m for m in matches if z[m.queryIdx] > 0]
        if len(matches) < INLIERS:
            return None
        i, j = ([getattr(m, name) for m in matches] for name in ('queryIdx', 'trainIdx'))
        points = np.column_stack([a[1][i], np.ones(len(i))]) * z[i][:, None]
        found, vector, _, inliers = cv2.solvePnPRansac(points, b[1][j][:, None], np.eye(3), None, iterationsCount=300,
                                                       reprojectionError=REPROJECTION / self.recording.camera.fx, flags=cv2.SOLVEPNP_ITERATIVE)
        if not found or inliers is None or len(inliers) < max(INLIERS, INLIER_RATIO * len(matches)):
            return None
        rotation = cv2.Rodrigues(vector)[0]
        return rotation if geometry.rotation_angle(rotation) < MOST_TURN else None


def mounting(of_poses, of_images):
    """Quaternion of the rotation X with of_poses ~ X of_images X^T, (n, 3, 3) each; None where none makes them agree."""
    a, b = (geometry.rotations_from_matrix(np.array(turns)).as_rotvec() for turns in (of_poses, of_images))
    lengths = np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    alike = np.abs(lengths[0] - lengths[1]) < 0.3 * np.maximum(*lengths)  # X changes the axes alone
    if 2 * np.sum(alike) < len(alike):
        return None
    a, b = a[alike], b[alike]
    u, d, vt = np.linalg.svd(a.T @ b)
    X = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    left = np.linalg.norm(a - b @ X.T, axis=1) / np.linalg.norm(b, axis=1)
    if d[1] < 0.05 * d[0] or np.median(left) > MOST_DISAGREEMENT / 2:  # turns about one axis leave X open
        return None
    return geometry.quaternion_from_matrix(X)


def compare(recording, frames):
    """The Agreement of a recording's reference poses with the images `frames`; with pairs 0 where nothing can be compared."""
    nothing = Agreement(0, 0.0, 0.0, 0.0, None)
    if len(recording.poses) < 2 or not recording.depth or not frames:
        return nothing
    poses, valid = geometry.interpolate_poses(recording.pose_stamps, recording.poses, [frame.stamp for frame in frames])
    images, of_poses, of_images = Images(recording), [], []
    for i, j, depth in choose_pairs(frames, recording.depth, poses, valid):
        seen = images.turn(frames[i], depth, frames[j])
        stated = poses[j, :3, :3].T @ poses[i, :3, :3]
        if seen is not None and max(geometry.rotation_angle(seen), geometry.rotation_angle(stated)) >= LEAST_TURN:
            of_poses.append(stated)
            of_images.append(seen)
    if not of_poses:
        return nothing
    differences = geometry.rotation_angle(np.swapaxes(np.array(of_poses), 1, 2) @ np.array(of_images))
    turns = np.maximum(geometry.rotation_angle(np.array(of_poses)), geometry.rotation_angle(np.array(of_images)))
    answer = Agreement(len(of_poses), float(np.median(turns)), float(np.median(differences)), float(np.median(differences / turns)), None)
    if answer.refused():
        answer.rotation = mounting(of_poses, of_images)
    return answer


def describe(agreement, name):
    """One line about an Agreement for the recording's notes."""
    figures = f'{np.degrees(agreement.difference):.1f} of {np.degrees(agreement.turn):.1f} degrees, medians of {agreement.pairs} pairs of images'
    if agreement.pairs < FEWEST:
        return f'reference poses not compared with the images: {agreement.pairs} pairs of images with texture, depth and a turn, {FEWEST} are needed'
    if not agreement.refused():
        return f'reference poses turn as the images do: they differ by {figures}'
    text = f'reference poses turn otherwise than the images of {name} do, by {figures}: they are not its camera\'s'
    if agreement.rotation is not None and abs(agreement.rotation[1]) > np.cos(np.radians(5)):
        text += ', but would agree if they were mirrored in y, which a negative fy_px in --config says'
    elif agreement.rotation is not None:
        q = ', '.join(f'{x:.4f}' for x in agreement.rotation)
        text += f', but would agree with a camera turned against their body: "pose_from_camera: {{translation_m: [x, y, z], quaternion_xyzw: [{q}]}}" in --config'
    return text + '; no ground truth is written, and no IMU made from them'
