"""Four simulations by two processes of Ray: `pip install . ray`."""

import ray

import softarm as sa

if __name__ == "__main__":
    tasks = [{"verb": "simulate", "scene": "swing", "set": {"rod.elements": n, "time.end_s": 0.2}} for n in (4, 6, 8, 10)]
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    run = ray.remote(num_cpus=1)(sa.run)
    for task, done in zip(tasks, ray.get([run.remote(task) for task in tasks])):
        print(f"{task['set']['rod.elements']} elements: tip at {done['summary']['tip']['position_m']} m")
    ray.shutdown()
