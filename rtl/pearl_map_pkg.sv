// SPDX-License-Identifier: MIT
// The memory map of a build: how many words each region has, and where it starts.
//
// pearl_marl/memory_map.py explains the layout and computes the same for the host; a test compares the two.
package pearl_map_pkg;
  import pearl_pkg::*;
  import pearl_core_pkg::*;
  import pearl_engine_pkg::*;

  localparam int unsigned SLOT_BITS = TER_BITS + STATE_BITS;

  // Words of a memory that holds a row of slots a group: a row has a power of two of them, so that an
  // address splits into row and column by its bits.
  function automatic int unsigned row_words(int unsigned n_envs, int unsigned pe_num, int unsigned data_wl,
                                            int unsigned slot_bits);
    return ceil_div(n_envs, pe_num) << $clog2(stream_words(pe_num, slot_bits, data_wl));
  endfunction

  function automatic int unsigned region_words(int unsigned region, int unsigned n_envs, int unsigned pe_num,
                                               int unsigned data_wl);
    case (region)
      Control: return stream_words(CONTROL_WORDS, 32, data_wl);
      InitialStates: return row_words(n_envs, pe_num, data_wl, STATE_BITS);
      CurrentStates: return row_words(n_envs, pe_num, data_wl, SLOT_BITS);
      Elapsed: return row_words(n_envs, pe_num, data_wl, ELAPSED_BITS);
      ResetMask: return stream_words(n_envs, 1, data_wl);
      Actions: return stream_words(n_envs, ACTION_BITS, data_wl);
      Doorbell: return stream_words(DOORBELL_WORDS, 32, data_wl);
      Observations: return stream_words(n_envs, OBS_BITS, data_wl);
      Rewards: return stream_words(n_envs, REWARD_BITS, data_wl);
      Ters: return stream_words(n_envs, TER_BITS, data_wl);
      Status: return stream_words(STATUS_WORDS, 32, data_wl);
      // Without a policy engine, the map ends with the status.
      Statistics: return ENGINE == NoEngine ? 0 : stream_words(STATISTICS_WORDS, 32, data_wl);
      default: return ENGINE == NoEngine ? 0 : 1 << POLICY_INDEX_BITS;
    endcase
  endfunction

  // The address of a region's first word; of NumRegions, that of the first hole.
  function automatic int unsigned region_offset(int unsigned region, int unsigned n_envs, int unsigned pe_num,
                                                int unsigned data_wl);
    int unsigned offset = 0;
    for (int unsigned i = 0; i < region; i++) begin
      offset += region_words(i, n_envs, pe_num, data_wl);
    end
    return offset;
  endfunction

endpackage
