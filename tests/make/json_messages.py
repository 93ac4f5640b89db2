"""JSON messages as bridges write them."""


def imu(x=0.0, y=0.0, z=0.0, stamp=None):
    """Return a message as bridges write it."""
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0} if stamp is None else stamp, "frame_id": "a"},
        "orientation": {"w": 1, "x": 0, "y": 0, "z": 0},
        "angular_velocity": {"x": x, "y": y, "z": z},
        "angular_velocity_covariance": [0, 0, 0, 0, 0, 0, 0, 0, 0],
    }
