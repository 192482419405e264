/* Start-up for an emulated Cortex-M: floating point on, data and bss in place, main, and its result as exit code. */
#include <stdint.h>

extern uint32_t target_data_load[];
extern uint32_t target_data_start[];
extern uint32_t target_data_end[];
extern uint32_t target_bss_start[];
extern uint32_t target_bss_end[];
extern uint32_t target_stack_top[];

int main(void);
void target_reset(void);
void target_fault(void);

static void target_exit(uint32_t code)
{
    const uint32_t block[2] = { 0x20026U, code };
    register uint32_t r0 __asm__("r0") = 0x20U; /* SYS_EXIT_EXTENDED */
    register const uint32_t *r1 __asm__("r1") = block;

    __asm__ volatile("bkpt 0xAB" : : "r"(r0), "r"(r1) : "memory");
    for (;;) {
    }
}

void target_reset(void)
{
    uint32_t *to;
    const uint32_t *from = target_data_load;

#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88U |= 0xFU << 20; /* CPACR: full access to CP10 and CP11 */
    __asm__ volatile("dsb\n\tisb" : : : "memory");
#endif
    for (to = target_data_start; to < target_data_end; ++to) {
        *to = *from++;
    }
    for (to = target_bss_start; to < target_bss_end; ++to) {
        *to = 0U;
    }
    target_exit((uint32_t)main());
}

void target_fault(void)
{
    target_exit(99U);
}

typedef void (*target_entry_t)(void);

__attribute__((section(".vectors"), used)) static const target_entry_t target_vectors[16] = {
    (target_entry_t)(uintptr_t)target_stack_top,
    target_reset, target_fault, target_fault, target_fault, target_fault, target_fault, target_fault,
    target_fault, target_fault, target_fault, target_fault, target_fault, target_fault, target_fault, target_fault,
};
