/* A loop that sleeps until its next tick and notes when it woke: the least that any loop on this system is late.
   steady HZ SECONDS FIFO SPIN: FIFO 1 asks for SCHED_FIFO, SPIN 1 lets a thread of the same process compute. */
#define _GNU_SOURCE
#include <pthread.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define NS 1000000000LL

static void *spin(void *nothing) {
    for (volatile long count = 0;; count++) {
    }
    return nothing;
}

int main(int argc, char **argv) {
    if (argc != 5) return 2;
    double hz = atof(argv[1]), seconds = atof(argv[2]);
    if (atoi(argv[4])) {
        pthread_t thread;
        pthread_create(&thread, NULL, spin, NULL); /* ordinary, whatever the loop is */
    }
    struct sched_param param = {.sched_priority = 11};
    if (atoi(argv[3]) && sched_setscheduler(0, SCHED_FIFO, &param)) {
        perror("SCHED_FIFO");
        return 1;
    }
    long count = (long)(hz * seconds), long_period = (long)(NS / hz);
    long long *stamps = malloc(sizeof *stamps * count);
    struct timespec next, now;
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (long at = 0; at < count; at++) {
        next.tv_nsec += long_period;
        while (next.tv_nsec >= NS) next.tv_nsec -= NS, next.tv_sec++;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
        clock_gettime(CLOCK_MONOTONIC, &now);
        stamps[at] = now.tv_sec * NS + now.tv_nsec;
    }
    for (long at = 0; at < count; at++) printf("%lld\n", stamps[at]);
    return 0;
}
