"""A Foxglove layout: the map in 3D, the image of the moment beside it."""

from __future__ import annotations

from typing import Any

_TOPICS = ("/map/grid", "/map/cloud", "/map/path", "/map/graph", "/map/pose")


def layout() -> dict[str, Any]:
    """As Foxglove's "Import from file" reads it."""
    topics: dict[str, Any] = {name: {"visible": True} for name in _TOPICS}
    topics["/map/cloud"] |= {"pointSize": 3, "colorMode": "rgb", "colorField": "rgb"}
    topics["/map/path"] |= {"type": "line", "lineWidth": 0.03, "gradient": ["#1f6fd1", "#1f6fd1"]}
    topics["/map/pose"] |= {"showCovariance": True, "type": "axis", "axisScale": 0.3}
    scene = {
        "followMode": "follow-none",
        "fixedFrame": "map",
        "followTf": "map",
        "scene": {"transforms": {"showLabel": False}},
        "cameraState": {"perspective": True, "distance": 40, "phi": 35, "thetaOffset": 0},
        "topics": topics,
    }
    image = {
        "imageMode": {"imageTopic": "/map/camera0/image", "calibrationTopic": "/map/camera0/info"}
    }
    return {
        "configById": {"3D!map": scene, "Image!node": image},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "first": "3D!map",
            "second": "Image!node",
            "direction": "row",
            "splitPercentage": 70,
        },
    }
