// SPDX-License-Identifier: MIT
// The keys of the random draws of one step (`key` of pearl_marl/golden/rng.py): a chain of mix32 over seed,
// tick and draw index, once with each of two initial values.
//
// A draw with no second key is a mix32, so the chains go round one pearl_draw, one a cycle behind the
// other. All but the last shared round is the same for the next tick: it is kept, and the keys of the next
// tick take DRAW_LATENCY * (1 + DRAWS) cycles. That is hidden, since they are made right after a step, not
// before one.
module pearl_rng
  import pearl_pkg::*;
#(
    // Draws of a slot in a step, and the index of the first.
    parameter int unsigned DRAWS = 1,
    parameter int unsigned FIRST = 0
) (
    input  logic                   clk_i,
    input  logic                   rst_ni,
    // In the cycle in which seed_i or the high word of tick_i may be new; in which only the low word is, by one.
    input  logic                   restart_i,
    input  logic                   next_i,
    input  logic [      1:0][31:0] seed_i,
    input  logic [     63:0]       tick_i,
    output logic                   valid_o,
    output logic [DRAWS-1:0][31:0] key_a_o,
    output logic [DRAWS-1:0][31:0] key_b_o
);

  // The rounds that all draws share: two words of seed, two of tick. Then one for each draw, and one in
  // which the last of them comes back.
  localparam int unsigned LAST_SHARED = 3;
  localparam int unsigned FIRST_DRAW = LAST_SHARED + 1;
  localparam int unsigned END = FIRST_DRAW + DRAWS;
  localparam int unsigned ROUND_BITS = $clog2(END + 1);
  localparam int unsigned PHASE_BITS = $clog2(DRAW_LATENCY);
  localparam int unsigned CHAINS = 2;

  logic valid_q, resumed_q, chain, chains_turn, last_phase_q;
  logic [ROUND_BITS-1:0] round_d, round_q;
  // The cycle of a round: in its own, what the last round made of a chain comes out, and goes in again.
  logic [PHASE_BITS-1:0] phase_q;
  logic [31:0] word_q, next_word_q, state, mixed;
  logic [1:0][31:0] kept_q, shared_q;
  logic [1:0][DRAWS-1:0][31:0] keys_q;

  assign chain = phase_q[0];
  assign chains_turn = !valid_q && 32'(phase_q) < CHAINS;

  always_comb begin
    round_d = round_q;
    if (restart_i) round_d = '0;
    else if (next_i) round_d = ROUND_BITS'(LAST_SHARED);
    else if (last_phase_q) round_d = round_q + 1'b1;
  end

  // A round is long enough to find the next one's word while it lasts.
  always_ff @(posedge clk_i) begin
    unique case (32'(round_q))
      0: next_word_q <= seed_i[1];
      1: next_word_q <= tick_i[63:32];
      2: next_word_q <= tick_i[31:0];
      default: next_word_q <= FIRST + 32'(round_q) - LAST_SHARED;
    endcase
    if (restart_i) word_q <= seed_i[0];
    else if (next_i) word_q <= tick_i[31:0];
    else if (last_phase_q) word_q <= next_word_q;
  end

  always_comb begin
    if (round_q == '0) state = chain ? CHAIN_B : CHAIN_A;
    else if (32'(round_q) == LAST_SHARED && resumed_q) state = kept_q[chain];
    else if (32'(round_q) > FIRST_DRAW) state = shared_q[chain];
    else state = mixed;
  end

  pearl_draw u_mix (
      .clk_i,
      .slot_i (state),
      .key_a_i(word_q),
      .key_b_i('0),
      .draw_o (mixed)
  );

  always_ff @(posedge clk_i) begin
    if (chains_turn) begin
      if (32'(round_q) == LAST_SHARED && !resumed_q) kept_q[chain] <= mixed;
      if (32'(round_q) == FIRST_DRAW) shared_q[chain] <= mixed;
      for (int unsigned i = 0; i < DRAWS; i++) begin
        if (32'(round_q) == FIRST_DRAW + 1 + i) keys_q[chain][i] <= mixed;
      end
    end
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni || restart_i || next_i) begin
      valid_q      <= 1'b0;
      resumed_q    <= rst_ni && !restart_i;
      phase_q      <= '0;
      last_phase_q <= 1'b0;
    end else if (!valid_q) begin
      phase_q <= last_phase_q ? '0 : phase_q + 1'b1;
      last_phase_q <= 32'(phase_q) == DRAW_LATENCY - 2;
      valid_q <= 32'(round_q) == END && chain;
    end
    if (!rst_ni) round_q <= '0;
    else if (!valid_q || restart_i || next_i) round_q <= round_d;
  end

  assign valid_o = valid_q;
  assign key_a_o = keys_q[0];
  assign key_b_o = keys_q[1];

endmodule
