/* Preloaded by test_clock_steps.py: a wall clock that can be set for some processes alone.

   The file that WALL_CLOCK names holds by how many seconds it is set (int64), and may change at
   any time. Monotonic clocks are left as they are. Deadlines on the wall clock are moved back to
   the kernel's, as those that the C++ library waits with may be. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static int64_t step(void) {
    static volatile int64_t *seconds;
    if (!seconds)
        seconds = mmap(0, 8, PROT_READ, MAP_SHARED, open(getenv("WALL_CLOCK"), O_RDONLY), 0);
    return *seconds;
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    int failed = (int)syscall(SYS_clock_gettime, clock, now);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        now->tv_sec += step();
    return failed;
}

int gettimeofday(struct timeval *now, void *zone) {
    struct timespec exact;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &exact);
    now->tv_sec = exact.tv_sec;
    now->tv_usec = exact.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *now) {
    struct timespec exact;
    clock_gettime(CLOCK_REALTIME, &exact);
    if (now) *now = exact.tv_sec;
    return exact.tv_sec;
}

/* No machine has been up for thirty years: what is later is a deadline on the wall clock. */
static struct timespec true_deadline(const struct timespec *deadline) {
    struct timespec moved = *deadline;
    if (moved.tv_sec > 1000000000) moved.tv_sec -= step();
    return moved;
}

int pthread_cond_timedwait(pthread_cond_t *c, pthread_mutex_t *m, const struct timespec *d) {
    static int (*wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    struct timespec moved = true_deadline(d);
    if (!wait) wait = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    return wait(c, m, &moved);
}

int pthread_mutex_timedlock(pthread_mutex_t *m, const struct timespec *d) {
    static int (*lock)(pthread_mutex_t *, const struct timespec *);
    struct timespec moved = true_deadline(d);
    if (!lock) lock = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
    return lock(m, &moved);
}

int sem_timedwait(sem_t *s, const struct timespec *d) {
    static int (*wait)(sem_t *, const struct timespec *);
    struct timespec moved = true_deadline(d);
    if (!wait) wait = dlsym(RTLD_NEXT, "sem_timedwait");
    return wait(s, &moved);
}
