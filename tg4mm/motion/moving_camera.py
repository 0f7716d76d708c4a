def fit_moving_camera(*a):
    raise NotImplementedError
