"""The robot, its world in MuJoCo, drive, odometry noise and lidar."""
