from zoac.core.seeding import stream, stream_seed


def test_a_stream_is_the_same_every_time():
    assert (
        stream(3, "lane", 2).normal(size=4).tolist() == stream(3, "lane", 2).normal(size=4).tolist()
    )


def test_streams_differ_by_seed_name_and_index():
    seeds = {
        stream_seed(seed, name, index)
        for seed in (0, 1)
        for name in ("lane", "tuner", "critic")
        for index in (0, 1)
    }
    assert len(seeds) == 12
