def fit_independent_clocks(*a):
    raise NotImplementedError
