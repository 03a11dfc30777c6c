"""The learner's end of the trajectory stream: admission, flow control and the state kept for each actor."""
