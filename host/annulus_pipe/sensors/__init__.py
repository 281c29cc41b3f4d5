"""What measures beside the camera: samples of a head's sensors, the acoustic rig's digitizer. Nothing here waits."""
