"""Compiled loops are kept for later runs, and compiled anew when anything they use has changed; threads share them."""

import threading

import pytest

from lfref.functional import loops


@pytest.mark.parametrize("n_threads", [0, 1, 2, 5])
def test_every_job_is_done_once(n_threads):
    done = []
    loops.share(done.append, ((job,) for job in range(100)), n_threads)
    assert sorted(done) == list(range(100))


@pytest.mark.parametrize("n_threads", [1, 2, 4])
def test_as_many_threads_work_at_once_the_calling_one_among_them(n_threads):
    barrier, names = threading.Barrier(n_threads, timeout=20), []

    def work(job):
        barrier.wait()  # breaks unless so many arrive
        names.append(threading.get_ident())

    loops.share(work, [(job,) for job in range(n_threads)], n_threads)
    assert len(set(names)) == n_threads
    assert threading.get_ident() in names
    before = threading.active_count()
    loops.share(lambda: None, [()] * 3, n_threads)
    assert threading.active_count() == before


@pytest.mark.parametrize("n_threads", [1, 3])
@pytest.mark.parametrize("bad", range(4))
def test_what_a_job_raises_is_raised(n_threads, bad):
    def work(job):
        if job == bad:
            raise ValueError(f"job {job}")

    with pytest.raises(ValueError, match=f"job {bad}"):
        loops.share(work, [(job,) for job in range(4)], n_threads)
