// The step of tomojax_step.h for C++17: tables that many steps share, and one step's memory.
//
//     tomojax::Tables tables("step.tables");
//     tomojax::Step step(tables);
//     for (;;) {
//         const tomojax_output &out = step(volts, condition);
//         for (int k = 0; k < out.count; k++) use(out.xy[k][0], out.xy[k][1]);
//         condition = ask(out.next_condition);
//     }
#ifndef TOMOJAX_STEP_HPP
#define TOMOJAX_STEP_HPP

#include <array>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <vector>

#include "tomojax_step.h"

namespace tomojax {

using Volts = std::array<tomojax_real, TOMOJAX_ELECTRODES>;

class Tables {
public:
    explicit Tables(const std::string &path)
    {
        if (const char *wrong = tomojax_step_load(path.c_str(), &tables_))
            throw std::runtime_error(path + ": " + wrong);
    }
    ~Tables() { tomojax_step_free(&tables_); }
    Tables(const Tables &) = delete;
    Tables &operator=(const Tables &) = delete;
    const tomojax_tables *get() const noexcept { return &tables_; }

private:
    tomojax_tables tables_{};
};

class Step {
public:
    explicit Step(const Tables &tables) : tables_(tables) { reset(); }
    void reset() { out_.next_condition = tomojax_step_init(tables_.get(), &state_); }
    const tomojax_output &operator()(const Volts &volts, std::int32_t condition,
                                     std::int32_t lost = 0, bool hurried = false)
    {
        tomojax_step(tables_.get(), &state_, volts.data(), condition, lost, hurried, &out_);
        return out_;
    }
    void use_policy(std::int32_t policy) { tomojax_step_switch(&state_, policy); }
    std::vector<tomojax_real> image() const
    {
        std::vector<tomojax_real> pixels(std::size_t(TOMOJAX_NX) * TOMOJAX_NY);
        tomojax_step_image(tables_.get(), &state_, pixels.data());
        return pixels;
    }
    std::int32_t next_condition() const noexcept { return out_.next_condition; }
    tomojax_state &state() noexcept { return state_; }

private:
    const Tables &tables_;
    tomojax_state state_{};
    tomojax_output out_{};
};

}  // namespace tomojax
#endif
