import threading

from neuse_encoder_node.worker import Worker


def test_items_are_worked_through_in_order_in_one_named_thread():
    done: list[tuple[int, str]] = []
    worker = Worker("stage", lambda i: done.append((i, threading.current_thread().name)), 100, lambda _: None)
    for item in range(50):
        worker.put(item)
    assert worker.drain(5.0)
    assert done == [(item, "stage") for item in range(50)]
    worker.stop()


def test_full_queue_drops_the_oldest_waiting_item_and_tells():
    started, go_on = threading.Event(), threading.Event()
    done: list[int] = []
    dropped: list[int] = []

    def work(item: int) -> None:
        started.set()
        go_on.wait(5.0)
        done.append(item)

    worker = Worker("stage", work, 2, dropped.append)
    worker.put(0)
    assert started.wait(5.0)
    for item in (1, 2, 3, 4):
        worker.put(item)
    go_on.set()
    assert worker.drain(5.0)
    assert (done, dropped) == ([0, 3, 4], [1, 2])
    worker.stop()


def test_drain_tells_when_the_work_takes_longer():
    go_on = threading.Event()
    worker = Worker("stage", lambda _: go_on.wait(5.0), 2, lambda _: None)
    worker.put(0)
    assert not worker.drain(0.05)
    go_on.set()
    assert worker.drain(5.0)
    worker.stop()


def test_stop_ends_the_thread():
    worker = Worker("stage-that-ends", lambda _: None, 2, lambda _: None)
    worker.stop()
    assert "stage-that-ends" not in {thread.name for thread in threading.enumerate()}
